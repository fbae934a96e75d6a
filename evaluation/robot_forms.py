"""Everything that counts as a robot in Python, brought to one form: a callable with `reset`.

Imports nothing of this project: it also runs in a robot's own process, where `zoo` and `evaluation`
may be somebody else's modules.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

FORMS = (
    "a callable from observations [N, O] to actions [N, A], an object with act(obs) and "
    "reset(n), one with predict(obs, state=, episode_start=, deterministic=), or a Flax module "
    "with its parameters: (module, params)"
)


class Robot:
    """A callable from float32 observations [N, O] to whatever the robot answers, [N, A]."""

    def __init__(
        self,
        act: Callable[[np.ndarray], Any],
        reset: Callable[[int], Any] | None = None,
    ) -> None:
        self._act, self._reset = act, reset

    def reset(self, rows: int) -> None:
        """Tell the robot, if it wants to know, that `rows` episodes begin."""
        if self._reset is not None:
            self._reset(rows)

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return the answer as NumPy sees it."""
        answer = self._act(obs)
        return np.asarray(answer.detach().cpu() if hasattr(answer, "detach") else answer)


def as_robot(robot: Any) -> Robot:
    """Return a robot of any of the forms as one callable.

    Raises:
        TypeError: it has none of them.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, tuple) and len(robot) == 2 and hasattr(robot[0], "apply"):
        return Robot(_flax(*robot))
    if hasattr(robot, "unbind") and getattr(robot, "scope", None) is not None:
        return Robot(_flax(*robot.unbind()))
    if callable(getattr(robot, "predict", None)):
        predicting = _Predicting(robot)
        return Robot(predicting.act, predicting.reset)
    act = getattr(robot, "act", robot)
    if not callable(act) or hasattr(robot, "unbind"):
        raise TypeError(f"{type(robot).__name__} is no robot; expected {FORMS}")
    reset = getattr(robot, "reset", None)
    return Robot(act, reset if callable(reset) else None)


class _Predicting:
    """A Stable-Baselines3 model, recurrent or not."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.reset(0)

    def reset(self, rows: int) -> None:
        self._state, self._first = None, True

    def act(self, obs: np.ndarray) -> Any:
        starts, self._first = np.full(len(obs), self._first), False
        action, self._state = self._model.predict(
            obs, state=self._state, episode_start=starts, deterministic=True
        )
        return action


def _flax(module: Any, params: Any) -> Callable[[np.ndarray], Any]:
    import jax

    variables = params if "params" in params else {"params": params}
    apply = jax.jit(lambda variables, obs: module.apply(variables, obs))
    return lambda obs: apply(variables, obs)
