"""The process of a robot from outside: loads it, and answers observations with actions.

Started as a file by `evaluation.cast.policy_process`, with a module path of the robot's own.
Imports nothing of this project by name: `zoo` and `evaluation` may be somebody else's modules here.

A message is two lengths, a JSON object and the bytes of an array: nothing is unpickled.
"""

import contextlib
import ctypes
import importlib
import importlib.util
import json
import os
import signal
import struct
import sys
import threading
import time
import traceback
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO

import numpy as np

_LENGTHS = struct.Struct("<IQ")  # bytes of the JSON object, bytes of the array


_HERE = Path(__file__).resolve().parent
_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of linux/prctl.h
LONGEST_MESSAGE = 1000  # characters
LARGEST_ANSWER = 64 << 20  # bytes: the actions of a million simulations


class LoadError(Exception):
    """Why a robot cannot be loaded, in the words that the user reads."""


def send(stream: BinaryIO, header: dict[str, Any], array: np.ndarray | None = None) -> None:
    """Write one message."""
    payload = b"" if array is None else np.ascontiguousarray(array).tobytes()
    if array is not None:
        header = {**header, "shape": array.shape, "dtype": array.dtype.str}
    text = json.dumps(header).encode()
    stream.write(_LENGTHS.pack(len(text), len(payload)) + text + payload)
    stream.flush()


def receive(stream: BinaryIO, most: int | None = None) -> tuple[dict[str, Any], np.ndarray | None]:
    """Read one message, of at most so many bytes.

    Raises:
        EOFError: the other side is gone, or says more than that.
    """
    text, payload = _LENGTHS.unpack(_read(stream, _LENGTHS.size))
    if most is not None and max(text, payload) > most:
        raise EOFError
    header = json.loads(_read(stream, text))
    data = _read(stream, payload)
    if "dtype" not in header:
        return header, None
    # Copied, because robots may write into what they are given.
    return header, np.frombuffer(data, header["dtype"]).reshape(header["shape"]).copy()


def error_text(error: BaseException) -> str:
    """Say an exception in one printable line, with the place in the user's code."""
    frames = traceback.extract_tb(error.__traceback__)
    theirs = frames and Path(frames[-1].filename).parent != _HERE  # ours says what was wrong
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if theirs else ""
    message = one_line(str(error))
    return f"{type(error).__name__}{': ' if message else ''}{message}{place}"


def one_line(text: str) -> str:
    """Return text that somebody else may have chosen as one printable line, cut if long."""
    text = text[:LONGEST_MESSAGE]
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def serve() -> None:
    """Answer messages until the parent is gone."""
    inbox, outbox = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)  # what the robot prints is for people
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, who ends this process
    _die_with_parent()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    robot: Any = None
    play = contextlib.ExitStack()  # as long as the process: nothing has to be given back
    while True:
        try:
            header, obs = receive(inbox)
        except EOFError:
            return
        reply, answer = {}, None
        try:
            if header["do"] == "load":
                robot, reply = _load(header)
                play.enter_context(robot.playing())
            elif header["do"] == "reset":
                robot.reset(header["rows"])
            else:
                answer = robot(obs)
                if answer.dtype.kind not in "fiu" or answer.nbytes > LARGEST_ANSWER:
                    raise TypeError(f"returned {answer.dtype} of shape {answer.shape}")
        except LoadError as error:
            reply, answer = {"error": one_line(str(error))}, None
        except BaseException as error:  # SystemExit too: the robot's code does not end a run
            reply, answer = {"error": error_text(error)}, None
        send(outbox, reply, answer)


def _load(header: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """Make the robot; return with it the files that its code is in, and those that it declares."""
    forms = _import_ours("evaluation_mode", "robot_forms")
    sys.path[:] = header["path"]
    name, factory = header["module"], header["factory"]
    try:
        if name.endswith(".py"):
            module = _import(name, Path(name).stem)
        else:
            module = importlib.import_module(name)
    except BaseException as error:
        raise LoadError(f"cannot import {name}: {error_text(error)}") from error
    make = getattr(module, factory, None)
    if not callable(make):
        raise LoadError(f"{name} has no function {factory!r}; name the robot's factory")
    try:
        made = make(**header["arguments"])
    except BaseException as error:
        if header["plain"] and isinstance(error, ValueError):
            raise LoadError(str(error)) from error
        raise LoadError(f"{factory}() failed: {error_text(error)}") from error
    try:
        robot = forms.as_robot(made)
    except TypeError as error:
        kind = type(made).__name__
        raise LoadError(f"{factory}() returned {kind}; expected {forms.FORMS}") from error
    depends = getattr(module, "DEPENDS", None)
    if depends is not None:
        if isinstance(depends, str) or not isinstance(depends, Iterable):
            raise LoadError(f"DEPENDS of {name} is {depends!r}; expected a list of paths")
        depends = [str(path) for path in depends]
    trained_with = getattr(module, "TRAINED_WITH", None)
    names = [trained_with] if isinstance(trained_with, str) else trained_with
    if names is not None and not (
        isinstance(names, list | tuple) and all(isinstance(name, str) for name in names)
    ):
        kind = type(trained_with).__name__
        raise LoadError(f"TRAINED_WITH of {name} is {kind}; expected a text or a list of texts")
    metadata = getattr(made, "metadata", None) if header["plain"] else None  # of our ONNX robot
    return robot, {
        "files": _own_files(module, header["foreign"]),
        "depends": depends,
        "trained_with": trained_with,
        "metadata": metadata,
    }


def _import_ours(*names: str) -> ModuleType:
    """Return the last of these files of ours, which import each other; the robot meets no name."""
    modules = {f"evaluation.cast.{name}": f"{_HERE / name}.py" for name in names}
    made = [_import(path, name) for name, path in modules.items()]
    for name in modules:
        del sys.modules[name]
    return made[-1]


def _import(path: str, name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _own_files(module: ModuleType, foreign: list[str]) -> list[str]:
    """Return the module's file, then those of its folder and the working one that it imported."""
    own = Path(module.__file__ or "").resolve()
    paths = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
    # Not all of them are there: PyTorch has a module whose file is said to be "_classes.py".
    named = {Path(file).resolve() for file in paths if file and file.endswith(".py")}
    files = {file for file in named if file.is_file()} - {own}
    roots, others = (own.parent, Path.cwd()), [Path(folder) for folder in foreign]

    def is_own(file: Path) -> bool:
        installed = "site-packages" in file.parts or any(map(file.is_relative_to, others))
        return not installed and any(map(file.is_relative_to, roots))

    return [str(own), *sorted(str(file) for file in files if is_own(file))]


def _read(stream: BinaryIO, count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise EOFError
    return data


def _die_with_parent() -> None:
    """Let Linux kill this process when its parent ends: a stopped process cannot end itself."""
    with contextlib.suppress(OSError, AttributeError):  # elsewhere
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)


def _end_with(parent: int) -> None:
    """End this process when its parent is gone, also out of a robot that never answers."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


if __name__ == "__main__":
    serve()
