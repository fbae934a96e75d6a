"""One simulation with NumPy in and out, which the PettingZoo and Gymnasium adapters share."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from assistax_envs.adapters.batch import OBSERVATION_BOUND
from assistax_envs.disability import Disability
from assistax_envs.env import EnvState, disability_params, make
from assistax_envs.humans import EnvParams
from assistax_envs.own_settings import key_of, own_settings

INSTALL = "install it with: pip install 'assistax-zoo[adapters]'"


class Simulation:
    """Batch of one simulation, stepped from outside JAX."""

    def __init__(
        self,
        task: str,
        disability: str | Disability = "d1",
        backend: str = "native",
        weights: dict[str, float] | None = None,
        render_mode: str | None = None,
        camera: str | None = None,
        version: int | None = None,
        humans: EnvParams | None = None,
    ) -> None:
        """Make the simulation.

        Args:
            task: See `assistax_envs.make`.
            disability: The human's, "d1".."d9" or a `Disability`.
            backend: See `assistax_envs.make`.
            weights: See `assistax_envs.make`.
            render_mode: None or "rgb_array".
            camera: Camera of the pictures.
            version: See `assistax_envs.make`.
            humans: A person's own `EnvParams` [1], in place of the disability.
        """
        if render_mode not in (None, "rgb_array"):  # other modes need a window
            raise ValueError(f"render_mode is {render_mode!r}; allowed are None and 'rgb_array'")
        self.render_mode, self._camera = render_mode, camera
        self.env = make(task, backend, weights, version)
        self._params = disability_params([disability]) if humans is None else humans
        self._reset, self._step = jax.jit(self.env.reset), jax.jit(self.env.step)
        self._state: EnvState | None = None

    @property
    def state(self) -> EnvState:
        """The current state, every leaf [1, ...].

        Raises:
            ValueError: no episode was started yet.
        """
        if self._state is None:
            raise ValueError("no episode runs yet; call reset() first")
        return self._state

    @own_settings()
    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode from a key drawn from `rng`."""
        key = key_of(int(rng.integers(2**32, dtype=np.uint32)))
        self._state = self._reset(key[None], self._params)

    @own_settings()
    def step(self, actions: Mapping[str, Any]) -> None:
        """Advance by one control step.

        Args:
            actions: By role; "word" may stand beside them, what the human says, a code of
                `assistax_envs.preferences`.

        Raises:
            ValueError: no episode runs, it has ended, or an action is missing or of the wrong
                shape.
        """
        if bool(self.state.truncated[0] | self.state.terminated[0]):
            raise ValueError(
                f"the episode ended at step {int(self.state.step[0])}; call reset() first"
            )
        batch = {role: self._action(role, actions) for role in self.env.action_size}
        if "word" in actions:
            batch["word"] = np.array([actions["word"]], np.int32)
        self._state = self._step(self.state, batch)

    @own_settings()
    def observation(self, name: str) -> np.ndarray:
        """Return a copy of the observation [O] of "robot", "human" or "global", within bounds."""
        return np.clip(np.array(self.state.obs[name][0]), -OBSERVATION_BOUND, OBSERVATION_BOUND)

    @own_settings()
    def info(self) -> dict[str, Any]:
        """Return the measures of the last step, as new plain numbers."""
        state = self.state
        return {
            "terms": {name: float(value[0]) for name, value in state.terms.items()},
            "force": float(state.measures.force[0]),
            "distance": float(state.measures.distance[0]),
            "success": bool(state.measures.success[0]),
            "nonfinite": bool(state.nonfinite[0]),
        }

    def render(self) -> np.ndarray | None:
        """Return a picture, uint8 [480, 640, 3]; None unless `render_mode` is "rgb_array"."""
        if self.render_mode is None:
            return None
        return self.env.render(self.state, camera=self._camera)

    @own_settings()
    def outcome(self) -> tuple[float, bool, bool]:
        """Return reward, terminated and truncated of the last step."""
        state = self.state
        return float(state.reward[0]), bool(state.terminated[0]), bool(state.truncated[0])

    def _action(self, role: str, actions: Mapping[str, Any]) -> np.ndarray:
        """Return an agent's checked action [1, A]."""
        size = self.env.action_size[role]
        if role not in actions:
            raise ValueError(
                f"no action for {role!r}; each step needs one for "
                f"{' and '.join(self.env.action_size)}"
            )
        action = np.asarray(actions[role], np.float32)
        if action.shape != (size,):
            raise ValueError(
                f"the action of {role!r} has shape {action.shape}; expected ({size},), values in "
                "[-1, 1]"
            )
        return action[None]
