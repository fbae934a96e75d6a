"""The process of a robot from outside: loads it, and answers observations with actions.

Started as a file by `evaluation.cast.policy_process`, with a module path of the robot's own.
Imports nothing of this project by name: `zoo` and `evaluation` may be somebody else's modules here.

A message is two lengths, a JSON object and the bytes of an array: nothing is unpickled.
"""

import contextlib
import ctypes
import hashlib
import importlib
import importlib.util
import json
import os
import signal
import struct
import sys
import sysconfig
import threading
import time
import traceback
from collections.abc import Iterable, Mapping
from importlib.machinery import SourceFileLoader
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
    code: Any = None
    play = contextlib.ExitStack()  # as long as the process: nothing has to be given back
    while True:
        try:
            header, obs = receive(inbox)
        except EOFError:
            return
        reply, answer = {}, None
        try:
            if header["do"] == "load":
                robot, reply, code = _load(header)
                play.enter_context(robot.playing())
            elif header["do"] == "loaded":
                reply = {"files": code.files()}
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


def _load(header: dict[str, Any]) -> tuple[Any, dict[str, Any], "_OwnCode"]:
    """Make the robot; return it with the files and the code that its results depend on."""
    forms = _import_ours("evaluation_mode", "robot_forms")
    sys.path[:] = header["path"]
    name, factory, code = header["module"], header["factory"], _OwnCode(header["foreign"])
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
    code.of(module)
    depends = _depends(module, name)
    arguments = [] if header["plain"] else [*header["arguments"].values()]
    inputs = _hashed(arguments, depends or [], code.folder)
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
    trained_with = getattr(module, "TRAINED_WITH", None)
    names = [trained_with] if isinstance(trained_with, str) else trained_with
    if names is not None and not (
        isinstance(names, list | tuple) and all(isinstance(name, str) for name in names)
    ):
        kind = type(trained_with).__name__
        raise LoadError(f"TRAINED_WITH of {name} is {kind}; expected a text or a list of texts")
    metadata = getattr(made, "metadata", None) if header["plain"] else None  # of our ONNX robot
    reply = {
        "files": code.files(),
        "inputs": inputs,
        "declares": depends is not None,
        "trained_with": trained_with,
        "metadata": metadata,
    }
    return robot, reply, code


def _depends(module: ModuleType, name: str) -> list[str] | None:
    """Return the paths that a module declares, None where it declares nothing."""
    depends = getattr(module, "DEPENDS", None)
    if depends is None:
        return None
    if isinstance(depends, str) or not isinstance(depends, Iterable):
        raise LoadError(f"DEPENDS of {name} is {depends!r}; expected a list of paths")
    return [str(path) for path in depends]


def _hashed(arguments: list[str], declared: list[str], folder: Path) -> list[tuple[str, str]]:
    """Return path and sha256 of the files that arguments name, and of those that are declared."""
    named = [Path(value) for value in arguments if os.path.isfile(value)]
    paths = [folder / name for name in declared]
    for path in paths:
        if path.exists() and not path.is_file():  # a device or a pipe would never end
            raise LoadError(f"DEPENDS names {path}, which is no regular file")
    try:
        return [(str(path), _file_sha256(path)) for path in (*named, *paths)]
    except OSError as error:
        raise LoadError(str(error)) from None


class _OwnCode:
    """The files of the robot's own code, each with the sha256 of the bytes that were run."""

    def __init__(self, foreign: list[str]) -> None:
        """Begin to listen; `foreign` are folders of code that is not the robot's."""
        self._foreign = [Path(folder) for folder in (*foreign, sysconfig.get_paths()["stdlib"])]
        self._ran: dict[str, set[str]] = {}
        self._module: ModuleType | None = None
        usual = SourceFileLoader.get_code

        def get_code(loader: Any, name: str) -> Any:
            if self._is_installed(Path(loader.path).resolve()):
                return usual(loader, name)
            data = loader.get_data(loader.path)  # once: what is hashed is what runs
            self._note(loader.path, data)
            return loader.source_to_code(data, loader.path)

        SourceFileLoader.get_code = get_code  # ty: ignore[invalid-assignment]

    def of(self, module: ModuleType) -> None:
        """Say which module the robot is made by: its folder and the working one hold the code."""
        self._module = module
        self.folder = Path(module.__file__ or "").resolve().parent

    def files(self) -> Mapping[str, list[str]]:
        """Return all that ran until now, the module's own file first; usually one hash a file."""
        own = Path(getattr(self._module, "__file__", None) or "").resolve()
        paths = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
        # Not all of them are there: PyTorch has a module whose file is said to be "_classes.py".
        named = {Path(file).resolve() for file in paths if file and file.endswith(".py")}
        named = {file for file in named if file.is_file()} | {Path(file) for file in self._ran}
        files = [own, *sorted(file for file in named - {own} if self._is_own(file))]
        return {
            str(file): sorted(self._ran.get(str(file)) or {_file_sha256(file)}) for file in files
        }

    def _note(self, path: str, data: bytes) -> None:
        self._ran.setdefault(str(Path(path).resolve()), set()).add(hashlib.sha256(data).hexdigest())

    def _is_installed(self, file: Path) -> bool:
        return "site-packages" in file.parts or any(map(file.is_relative_to, self._foreign))

    def _is_own(self, file: Path) -> bool:
        roots = (self.folder, Path.cwd())
        return not self._is_installed(file) and any(map(file.is_relative_to, roots))


def _file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
