"""Everything that counts as a robot in Python, brought to one form: a callable with `reset`.

Imports nothing of this project: it also runs in a robot's own process, where `zoo` and `evaluation`
may be somebody else's modules.
"""

import contextlib
import os
import sys
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

FORMS = (
    "a callable from observations [N, O] to actions [N, A], an object with act(obs) and "
    "reset(n), one with predict(obs, state=, episode_start=, deterministic=), a PyTorch module, or "
    "a Flax module with its parameters: (module, params)"
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
        with _one_torch_thread():
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
    if _method(robot, "predict"):
        robot = _Predicting(robot)
    act = _torch(robot) if _is_torch_module(robot) else robot
    act = _method(robot, "act") or act
    if not callable(act) or hasattr(robot, "unbind"):
        raise TypeError(f"{type(robot).__name__} is not a robot; expected {FORMS}")
    return Robot(act, _method(robot, "reset"))


def _method(robot: Any, name: str) -> Any:
    """Return a method; none where the name is a layer's, as often `act` of an activation."""
    method = getattr(robot, name, None)
    return method if callable(method) and not _is_torch_module(method) else None


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


def _is_torch_module(robot: Any) -> bool:
    torch: Any = sys.modules.get("torch")  # whoever has a module of it has imported it
    return torch is not None and isinstance(robot, torch.nn.Module)


def _torch(module: Any) -> Callable[[np.ndarray], Any]:
    """Return a module's forward pass on arrays; puts the module into evaluation mode."""
    torch: Any = sys.modules["torch"]
    module.eval()  # a training mode would draw, or look at other episodes
    like = next(module.parameters(), torch.zeros(0))

    def act(obs: np.ndarray) -> Any:
        with torch.inference_mode():
            return module(torch.tensor(obs, dtype=like.dtype, device=like.device))

    return act


@contextlib.contextmanager
def _one_torch_thread() -> Generator[None]:
    """Keep PyTorch to one thread: others would spin while the simulation runs.

    Nothing changes where PyTorch is not loaded, or OMP_NUM_THREADS says how many there are.
    """
    torch: Any = None if "OMP_NUM_THREADS" in os.environ else sys.modules.get("torch")
    threads = 1 if torch is None else torch.get_num_threads()
    if threads == 1:
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _flax(module: Any, params: Any) -> Callable[[np.ndarray], Any]:
    import jax

    variables = params if "params" in params else {"params": params}
    apply = jax.jit(lambda variables, obs: module.apply(variables, obs))
    return lambda obs: apply(variables, obs)
