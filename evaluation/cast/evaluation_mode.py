"""Put a robot's networks into evaluation mode while it plays, and restore them afterwards.

This module imports nothing of this project, because it also runs in a robot's own process, like
`evaluation.cast.robot_forms`.
"""

import collections
import contextlib
import functools
import inspect
import random
import sys
import types
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

# Attributes of modules that switch to evaluation, by framework. PyTorch has a method for it.
_MODES = {
    "flax.nnx": {"deterministic": True, "use_running_average": True},
    "equinox": {"inference": True},
}
# Largest number of a robot's objects, and of items in one container, that are searched.
_MOST_PARTS, _LONGEST = 10_000, 1_000
_METHODS = ("__call__", "act", "predict", "reset")


@contextlib.contextmanager
def as_used(robot: Any) -> Generator[None]:
    """Put a robot's networks into evaluation mode in a `with` block, and restore all state."""
    parts = _parts(robot)
    with contextlib.ExitStack() as restoring:
        for keep in (_keep_generators, _keep_torch, _keep_modes, _keep_variables):
            for restore in keep(parts):
                restoring.callback(restore)
        for part in parts:
            if is_torch_module(part) and part.training:
                part.eval()
            for name, value in _modes(part).items():
                vars(part)[name] = value  # some frameworks freeze their modules
        yield


def _parts(robot: Any) -> list[Any]:
    """Return the robot and all objects that it reaches through attributes and code."""
    found: dict[int, Any] = {}
    queue = collections.deque([robot])
    while queue and len(found) < _MOST_PARTS:
        part = queue.popleft()
        if id(part) not in found:
            found[id(part)] = part
            with contextlib.suppress(Exception):  # some objects are not what they seem
                queue.extend(_held_objects(part))
    return list(found.values())


def _held_objects(part: Any) -> Iterator[Any]:
    """Yield the objects that an object directly holds, without running its code."""
    kind = type(part)
    if issubclass(kind, types.ModuleType | type | np.ndarray | str | bytes | int | float):
        return
    if issubclass(kind, dict | list | tuple | set | frozenset):
        if len(part) <= _LONGEST:
            yield from part.values() if issubclass(kind, dict) else part
        return
    if issubclass(kind, types.FunctionType):
        yield from _referenced_objects(part)
    elif issubclass(kind, types.MethodType):
        yield from (part.__self__, part.__func__)
    elif issubclass(kind, functools.partial):
        yield from (part.func, part.args, part.keywords)
    else:
        if isinstance(attributes := getattr(part, "__dict__", None), dict):
            yield from list(attributes.values())
        methods = (inspect.getattr_static(kind, name, None) for name in _METHODS)
        yield from (one for one in methods if isinstance(one, types.FunctionType))


def _referenced_objects(function: types.FunctionType) -> Iterator[Any]:
    """Yield the values of a function's closure, globals and defaults."""
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):  # an empty one
            yield cell.cell_contents
    known = function.__globals__
    yield from (known[name] for name in function.__code__.co_names if name in known)
    yield from (function.__defaults__ or (), function.__kwdefaults__ or {})


Restoring = Iterable[Callable[[], Any]]


def _keep_generators(parts: list[Any]) -> Restoring:
    """Yield functions that restore random generators: the process's global ones and the robot's."""
    torch: Any = sys.modules.get("torch")
    yield functools.partial(random.setstate, random.getstate())
    yield functools.partial(np.random.set_state, np.random.get_state())
    for part in parts:
        if isinstance(part, np.random.Generator):
            bits = part.bit_generator
            yield functools.partial(setattr, bits, "state", bits.state)
        elif isinstance(part, random.Random):
            yield functools.partial(part.setstate, part.getstate())
        elif isinstance(part, np.random.RandomState):
            yield functools.partial(part.set_state, part.get_state())
    if torch is not None:
        yield functools.partial(torch.set_rng_state, torch.get_rng_state())
        if torch.cuda.is_available() and torch.cuda.is_initialized():
            yield functools.partial(torch.cuda.set_rng_state_all, torch.cuda.get_rng_state_all())


def _keep_torch(parts: list[Any]) -> Restoring:
    """Yield functions that restore modes, buffers and generators of PyTorch modules."""
    torch: Any = sys.modules.get("torch")
    if torch is None:
        return
    modules = [part for part in parts if is_torch_module(part)]
    modes = [(module, module.training) for module in modules]  # parents first
    buffers = [
        (module, name, buffer, buffer.clone())
        for module in modules
        for name, buffer in module.named_buffers(recurse=False)
        if not torch.nn.parameter.is_lazy(buffer)
    ]

    def restore() -> None:
        for module, was in modes:
            if module.training != was:
                module.train(was)
        for module, was in modes:  # what a module's own `train` leaves
            if module.training != was:
                module.training = was
        with torch.no_grad():
            for module, name, buffer, was in buffers:
                if not torch.equal(buffer, was):
                    buffer.copy_(was)
                if getattr(module, name) is not buffer:
                    setattr(module, name, buffer)

    yield restore
    for part in parts:
        if isinstance(part, torch.Generator):
            yield functools.partial(part.set_state, part.get_state())


def _keep_modes(parts: list[Any]) -> Restoring:
    for part in parts:
        if modes := _modes(part):
            yield functools.partial(vars(part).update, {name: vars(part)[name] for name in modes})


def _keep_variables(parts: list[Any]) -> Restoring:
    """Yield functions that restore Flax variables: statistics and counts of random keys."""
    nnx: Any = sys.modules.get("flax.nnx")
    for part in parts if nnx is not None else ():
        if issubclass(type(part), nnx.Variable):
            yield functools.partial(part.set_raw_value, part.get_raw_value())


def _modes(part: Any) -> Mapping[str, bool]:
    """Return the mode attributes that a module has, each with its value for evaluation."""
    for framework, modes in _MODES.items():
        if is_module(part, (framework,)):
            return {name: value for name, value in modes.items() if name in vars(part)}
    return {}


def is_module(part: Any, frameworks: Iterable[str] = ("torch.nn", *_MODES)) -> bool:
    """Return whether an object is a module of one of the frameworks, of those imported already."""
    loaded = [sys.modules[name] for name in frameworks if name in sys.modules]
    return any(issubclass(type(part), framework.Module) for framework in loaded)


def is_torch_module(part: Any) -> bool:
    """Return whether an object is a module of PyTorch."""
    return is_module(part, ("torch.nn",))
