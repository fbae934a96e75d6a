"""PettingZoo's `ParallelEnv`: robot and human as its two agents."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from assistax_envs.adapters.simulation import INSTALL, Simulation
from assistax_envs.disability import Disability

try:
    import gymnasium
    import pettingzoo
except ImportError as error:
    raise ImportError(f"this adapter needs the package pettingzoo; {INSTALL}") from error

ROLES = ("robot", "human")


class AssistaxParallelEnv(pettingzoo.ParallelEnv):
    """A task for two agents, "robot" and "human", who share the reward.

    An episode is truncated at its 1000th step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's own type
        "name": "assistax",
        "render_modes": ["rgb_array"],
        "is_parallelizable": True,
        "render_fps": 50,
    }

    def __init__(
        self,
        task: str,
        disability: str | Disability = "d1",
        backend: str = "native",
        weights: dict[str, float] | None = None,
        render_mode: str | None = None,
        camera: str | None = None,
    ) -> None:
        """See `assistax_envs.make`.

        `disability` is the human's, `render_mode` is None or "rgb_array".
        """
        self.render_mode = render_mode
        self.possible_agents = list(ROLES)
        self.agents: list[str] = []
        self._simulation = Simulation(task, disability, backend, weights, render_mode, camera)
        self._rng = np.random.default_rng()
        env = self._simulation.env
        self.observation_spaces = {role: _box(np.inf, env.observation_size[role]) for role in ROLES}
        self.action_spaces = {role: _box(1.0, env.action_size[role]) for role in ROLES}
        self.state_space = _box(np.inf, env.observation_size["global"])

    def observation_space(self, agent: str) -> gymnasium.Space:
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gymnasium.Space:
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Any]]]:
        """Start an episode.

        With a seed it and those after it are reproducible. `options` are not used.
        """
        if seed is not None:
            self._rng = np.random.default_rng(seed)
        self._simulation.reset(self._rng)
        self.agents = list(self.possible_agents)
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[
        dict[str, np.ndarray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Advance by 20 ms.

        Actions are clipped to [-1, 1]. Without agents left, nothing happens.
        """
        if not self.agents:
            return {}, {}, {}, {}, {}
        self._simulation.step(actions)
        reward, terminated, truncated = self._simulation.outcome()
        if terminated or truncated:
            self.agents = []
        return (
            self._observations(),
            dict.fromkeys(ROLES, reward),
            dict.fromkeys(ROLES, terminated),
            dict.fromkeys(ROLES, truncated),
            self._infos(),
        )

    def state(self) -> np.ndarray:
        """Return the observation for central critics, `global` [O]."""
        return self._simulation.observation("global")

    def render(self) -> np.ndarray | None:
        """See `Simulation.render`."""
        return self._simulation.render()

    def close(self) -> None:
        """Do nothing: there is no window."""

    def _observations(self) -> dict[str, np.ndarray]:
        return {role: self._simulation.observation(role) for role in ROLES}

    def _infos(self) -> dict[str, dict[str, Any]]:
        return {role: self._simulation.info() for role in ROLES}


def parallel_env(task: str, **options: Any) -> AssistaxParallelEnv:
    """Make the environment by the name that PettingZoo's own modules use."""
    return AssistaxParallelEnv(task, **options)


def _box(bound: float, size: int) -> gymnasium.spaces.Box:
    return gymnasium.spaces.Box(-bound, bound, (size,), np.float32)
