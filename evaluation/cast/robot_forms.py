"""Convert every accepted form of a robot to one: a callable with `reset`.

This module imports only `evaluation_mode` of this project. It also runs in a robot's own process,
where `zoo` and `evaluation` may be other modules of the same name.
"""

import contextlib
import functools
import inspect
import os
import sys
from collections.abc import Callable, Collection, Generator
from typing import Any

import numpy as np

from evaluation.cast.evaluation_mode import as_used, is_module, is_torch_module

FORMS = (
    "a callable from observations [N, O] to actions [N, A], an object with act(obs) and "
    "reset(n), one with predict(obs, state=, episode_start=, deterministic=), a PyTorch module, or "
    "a Flax module with its parameters: (module, params)"
)
# Arguments that switch a module's call to evaluation, with the value for each.
_ARGUMENTS = {
    "train": False,
    "training": False,
    "is_training": False,
    "deterministic": True,
    "use_running_average": True,
    "inference": True,
}
_PREDICTING = ("state", "episode_start", "deterministic")


class Robot:
    """A callable from float32 observations [N, O] to actions [N, A], not yet checked.

    The robot's networks are in evaluation mode during a call; see `playing`.
    """

    def __init__(
        self,
        act: Callable[[np.ndarray], Any],
        reset: Callable[[int], Any] | None = None,
        made_of: Any = None,
    ) -> None:
        self._act, self._reset = act, reset
        self._made_of = act if made_of is None else made_of
        self._plays = False

    @contextlib.contextmanager
    def playing(self) -> Generator[None]:
        """Put the robot into evaluation mode in a `with` block, and restore its state at the end.

        Restored are the mode of every module, buffers and other statistics, and the state of random
        generators. A call outside such a block is a block of its own.
        """
        if self._plays:
            yield
            return
        self._plays = True
        try:
            with as_used(self._made_of):
                yield
        finally:
            self._plays = False

    def reset(self, rows: int) -> None:
        """Call the robot's own `reset`, if it has one: `rows` episodes begin."""
        if self._reset is not None:
            self._reset(rows)

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        """Return the robot's answer to observations [N, O] as a NumPy array.

        Raises:
            TypeError: The answer is a sequence of parts with different shapes.
        """
        with self.playing(), _one_torch_thread():
            return _array(self._act(np.asarray(obs, np.float32)))


def as_robot(robot: Any) -> Robot:
    """Return an object of any form in `FORMS` as a `Robot`.

    Raises:
        TypeError: The object has no such form.
    """
    if isinstance(robot, Robot):
        return robot
    if isinstance(robot, tuple) and len(robot) == 2 and hasattr(robot[0], "apply"):
        return Robot(_flax(*robot))
    if hasattr(robot, "unbind") and getattr(robot, "scope", None) is not None:
        return Robot(_flax(*robot.unbind()))
    made_of = robot
    if _method(robot, "predict"):
        robot = _Predicting(robot)
    act: Any = robot
    if is_torch_module(robot):
        act = _torch(robot)
    elif is_module(robot):
        act = functools.partial(act, **_evaluation_arguments(robot))
    act = _method(robot, "act") or act
    if not callable(act) or hasattr(robot, "unbind"):
        raise TypeError(f"{type(robot).__name__} is not a robot; expected {FORMS}")
    return Robot(act, _method(robot, "reset"), made_of)


def _method(robot: Any, name: str) -> Any:
    """Return the object's method of this name, or None if the attribute is a layer of a network.

    A network's activation layer is often called `act`.
    """
    method = getattr(robot, name, None)
    return method if callable(method) and not is_module(method) else None


class _Predicting:
    """A model of Stable-Baselines3, recurrent or not, or one with a shorter `predict`."""

    def __init__(self, model: Any) -> None:
        self._model, self._takes = model, _accepted_names(model.predict, _PREDICTING)
        self.reset(0)

    def reset(self, rows: int) -> None:
        self._state, self._first = None, True

    def act(self, obs: np.ndarray) -> Any:
        starts, self._first = np.full(len(obs), self._first), False
        given = {"state": self._state, "episode_start": starts, "deterministic": True}
        answer = self._model.predict(obs, **{name: given[name] for name in self._takes})
        if "state" in self._takes and isinstance(answer, tuple):
            answer, self._state = answer
        return answer


def _accepted_names(function: Callable[..., Any], names: Collection[str]) -> list[str]:
    """Return those of `names` that a function takes as keywords; all if its signature is open."""
    try:
        parameters = inspect.signature(function).parameters
    except (TypeError, ValueError):  # written in C
        return list(names)
    if any(one.kind is inspect.Parameter.VAR_KEYWORD for one in parameters.values()):
        return list(names)
    return [name for name in names if name in parameters]


def _evaluation_arguments(call: Any) -> dict[str, bool]:
    """Return the keyword arguments that switch a module's call to evaluation."""
    try:
        parameters = inspect.signature(call).parameters
    except (TypeError, ValueError):
        return {}
    return {name: value for name, value in _ARGUMENTS.items() if name in parameters}


def _array(answer: Any) -> np.ndarray:
    """Return an answer as a NumPy array, with bfloat16 and similar floats as float32."""
    if hasattr(answer, "detach"):
        answer = answer.detach().cpu()
        if hasattr(answer, "element_size") and answer.is_floating_point():
            answer = answer.float() if answer.element_size() < 4 else answer
    if isinstance(answer, list | tuple) and any(hasattr(row, "shape") for row in answer):
        rows = [_array(row) for row in answer]
        if len({row.shape for row in rows}) > 1:
            raise TypeError(_parts_message(answer, rows))
        answer = rows
    try:
        array = np.asarray(answer)
    except ValueError:  # rows of different lengths
        raise TypeError(
            _parts_message(answer, [np.asarray(row, object) for row in answer])
        ) from None
    narrow = array.dtype.kind == "V" and np.can_cast(array.dtype, np.float32)  # such as bfloat16
    return array.astype(np.float32) if narrow else array


def _parts_message(answer: Any, rows: list[np.ndarray]) -> str:
    """Return the message for an answer whose parts have different shapes."""
    parts = [
        f"{type(part).__name__}{list(row.shape) if row.ndim else ''}"
        for part, row in zip(answer, rows, strict=True)
    ]
    listed = ", ".join(parts[:3]) + ", ..." * (len(parts) > 3)
    return (
        f"returned a {type(answer).__name__} of {len(parts)} parts of different shapes ({listed}); "
        "expected the actions alone, one array [N, A]"
    )


def _torch(module: Any) -> Callable[[np.ndarray], Any]:
    """Return a module's forward pass on NumPy arrays.

    Inputs are converted to the type and device of the module's parameters.
    """
    torch: Any = sys.modules["torch"]
    arguments = _evaluation_arguments(module.forward)
    numbers = [*module.parameters(), *module.buffers()]
    kinds = {number.dtype for number in module.parameters() if number.is_floating_point()}
    kind = kinds.pop() if len(kinds) == 1 else torch.float32
    device = numbers[0].device if numbers else torch.device("cpu")

    def act(obs: np.ndarray) -> Any:
        with torch.inference_mode():
            return module(torch.tensor(obs, dtype=kind, device=device), **arguments)

    return act


@contextlib.contextmanager
def _one_torch_thread() -> Generator[None]:
    """Limit PyTorch to one thread in a `with` block: idle threads would slow the simulation.

    Change nothing if PyTorch is not loaded or OMP_NUM_THREADS is set.
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
    arguments = _evaluation_arguments(type(module).__call__)
    apply = jax.jit(lambda variables, obs: module.apply(variables, obs, **arguments))
    return lambda obs: apply(variables, obs)
