"""Gymnasium's `Env`: the robot is the agent, and somebody else sits in the human's seat."""

from collections.abc import Callable
from typing import Any

import numpy as np

from assistax_envs.adapters.simulation import INSTALL, Simulation
from assistax_envs.disability import Disability
from assistax_envs.versions import VERSIONS

try:
    import gymnasium
except ImportError as error:
    raise ImportError(f"this adapter needs the package gymnasium; {INSTALL}") from error

Partner = Callable[
    [np.ndarray], Any
]  # observation [O] float32 -> action [3] in [-1, 1]; `reset()` if it has one


class AssistaxEnv(gymnasium.Env):
    """A robot's task with a partner that is part of the environment.

    An episode is truncated at its 1000th step.

    The partner is any callable from the human's observation to its action; one that remembers has a
    method `reset`, called at episode starts. Without a partner the human is passive: no torque at
    all.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 - Gymnasium's own type

    def __init__(
        self,
        task: str,
        partner: Partner | None = None,
        disability: str | Disability | None = None,
        backend: str = "native",
        weights: dict[str, float] | None = None,
        render_mode: str | None = None,
        camera: str | None = None,
    ) -> None:
        """Make the environment.

        Args:
            task: one of `assistax_envs.TASKS`.
            partner: who acts for the human.
            disability: the human's; by default the partner's own `setting`, where it has one,
                else "d1".
            backend: see `assistax_envs.make`.
            weights: reward weights that replace those of Table 5.
            render_mode: None or "rgb_array".
            camera: of the pictures; the scene's first if not given.
        """
        if partner is not None and not callable(partner):
            raise TypeError(
                f"partner is a {type(partner).__name__}; expected a callable from observation to "
                "action"
            )
        self.render_mode = render_mode
        self.partner = partner
        impairment = disability or getattr(partner, "setting", None) or "d1"
        self._simulation = Simulation(task, impairment, backend, weights, render_mode, camera)
        env = self._simulation.env
        self.observation_space = gymnasium.spaces.Box(
            -np.inf, np.inf, (env.observation_size["robot"],), np.float32
        )
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (env.action_size["robot"],), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode.

        With a seed it and those after it are reproducible. `options` are not used.
        """
        super().reset(seed=seed)
        self._simulation.reset(self.np_random)
        if callable(restart := getattr(self.partner, "reset", None)):
            restart()
        return self._simulation.observation("robot"), self._simulation.info()

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance by 20 ms: the partner acts on the same moment's observation.

        Actions are clipped to [-1, 1].
        """
        if self.partner is None:
            answer = np.zeros(self._simulation.env.action_size["human"], np.float32)
        else:
            answer = self.partner(self._simulation.observation("human"))
        self._simulation.step({"robot": action, "human": answer})
        observation, info = self._simulation.observation("robot"), self._simulation.info()
        return observation, *self._simulation.outcome(), info

    def render(self) -> np.ndarray | None:
        """See `Simulation.render`."""
        return self._simulation.render()


def register() -> tuple[str, ...]:
    """Register every task as `assistax/TASK-vVERSION` for `gymnasium.make`; return these ids."""
    ids = {task: f"assistax/{task}-v{version}" for task, version in VERSIONS.items()}
    for task, name in ids.items():
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=f"{__name__}:AssistaxEnv", kwargs={"task": task})
    return tuple(ids.values())
