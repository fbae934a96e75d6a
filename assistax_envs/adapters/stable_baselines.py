"""Stable-Baselines3's `VecEnv` around the Gymnasium vector form."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from assistax_envs.adapters.gymnasium import AssistaxVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError(
        "this adapter needs the package stable-baselines3; install it with: pip install "
        "'assistax-zoo[adapters,sb3]'"
    ) from error


class AssistaxVecEnv(VecEnv):
    """All simulations of an `AssistaxVectorEnv`; SB3's `VecMonitor` around it logs returns.

    SB3 wants a dictionary for each simulation, and reads it when an episode ends. At that step it
    has `terminal_observation`, `TimeLimit.truncated`, `is_success` and `violated`; at other steps
    it is empty.
    """

    def __init__(self, env: AssistaxVectorEnv) -> None:
        """Wrap an environment that returns NumPy arrays."""
        self.env = env  # first: SB3 asks it for its render mode
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: np.ndarray | None = None
        self._succeeded = self._violated = np.zeros(env.num_envs, bool)

    def reset(self) -> np.ndarray:
        """Return the observations at the start of an episode in every simulation, from `seed`."""
        seed, self._seeds = self._seeds[0], [None] * self.num_envs
        obs, _ = self.env.reset(seed=seed)
        self._succeeded = self._violated = np.zeros(self.num_envs, bool)
        return obs

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Return observations, rewards, ends and infos of the step that `step_async` requested."""
        obs, rewards, terminated, truncated, info = self.env.step(self._actions)
        ended = terminated | truncated
        return obs, rewards, ended, self._infos(info, ended, terminated)

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise ValueError(f"{attr_name} cannot be set: all simulations are one environment")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        raise ValueError(f"{method_name} cannot be called: all simulations are one environment")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> Sequence[bool]:
        return [False] * len(list(self._get_indices(indices)))

    def _infos(
        self, info: dict[str, Any], ended: np.ndarray, terminated: np.ndarray
    ) -> list[dict[str, Any]]:
        """Return a dictionary for each simulation."""
        final = info.get("final_info", info)
        of_care = "violated" in final  # whose success at the last step is that of the episode
        self._succeeded = final["success"] | (self._succeeded & (not of_care))
        self._violated = self._violated | final.get("violated", False)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for place in np.flatnonzero(ended):
            infos[place] = {
                "terminal_observation": info["final_obs"][place],
                "TimeLimit.truncated": not terminated[place],
                "is_success": bool(self._succeeded[place]),
                "violated": bool(self._violated[place]),
            }
        self._succeeded, self._violated = self._succeeded & ~ended, self._violated & ~ended
        return infos
