"""Program of a robot's own process: load the robot, and answer observations with actions.

`evaluation.cast.policy_process` starts this file with the robot's own module path. It imports no
module of this project by name, because `zoo` and `evaluation` may be other modules here.

A message is two lengths, a JSON object and the bytes of an array. It is never unpickled.
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
    """A robot cannot be loaded; the message is for its user."""


def send(stream: BinaryIO, header: dict[str, Any], array: np.ndarray | None = None) -> None:
    """Write one message: a header and perhaps an array."""
    payload = b"" if array is None else np.ascontiguousarray(array).tobytes()
    if array is not None:
        header = {**header, "shape": array.shape, "dtype": array.dtype.str}
    text = json.dumps(header).encode()
    stream.write(_LENGTHS.pack(len(text), len(payload)) + text + payload)
    stream.flush()


def receive(stream: BinaryIO, most: int | None = None) -> tuple[dict[str, Any], np.ndarray | None]:
    """Read one message; return its header and its array, or None if it has no array.

    Raises:
        EOFError: The stream ended, or the header or array has more than `most` bytes.
    """
    text, payload = _LENGTHS.unpack(_read(stream, _LENGTHS.size))
    if most is not None and max(text, payload) > most:
        raise EOFError
    header = json.loads(_read(stream, text))
    data = _read(stream, payload)
    if "dtype" not in header:
        return header, None
    # Copied, because a robot may write into its observations.
    return header, np.frombuffer(data, header["dtype"]).reshape(header["shape"]).copy()


def error_text(error: BaseException) -> str:
    """Return an exception as one printable line, with file and line of the user's code."""
    frames = traceback.extract_tb(error.__traceback__)
    in_user_code = frames and Path(frames[-1].filename).parent != _HERE
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if in_user_code else ""
    message = one_line(str(error))
    return f"{type(error).__name__}{': ' if message else ''}{message}{place}"


def one_line(text: str) -> str:
    """Return untrusted text as one printable line of at most `LONGEST_MESSAGE` characters."""
    text = text[:LONGEST_MESSAGE]
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def serve() -> None:
    """Answer messages until the parent process ends."""
    inbox, outbox = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    # The robot's prints go to standard error: standard output carries messages.
    os.dup2(2, 1)
    # The parent handles Ctrl-C and ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _die_with_parent()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    robot: Any = None
    code: Any = None
    # Never closed: the process ends without restoring the robot.
    play = contextlib.ExitStack()
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
        # SystemExit too: a robot's code must not end a run.
        except BaseException as error:
            reply, answer = {"error": error_text(error)}, None
        send(outbox, reply, answer)


def _load(header: dict[str, Any]) -> tuple[Any, dict[str, Any], "_OwnCode"]:
    """Make the robot; return it, the reply to the parent, and the record of its code."""
    forms = _import_ours("evaluation_mode", "robot_forms")
    sys.path[:] = header["path"]
    name, factory, code = header["module"], header["factory"], _OwnCode(header["foreign"])
    if name.endswith(".py") and not os.path.exists(name):
        raise LoadError(f"there is no file {name}")
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
    # Only this project's ONNX robot has metadata.
    metadata = getattr(made, "metadata", None) if header["plain"] else None
    reply = {
        "files": code.files(),
        "inputs": inputs,
        "declares": depends is not None,
        "trained_with": trained_with,
        "metadata": metadata,
    }
    return robot, reply, code


def _depends(module: ModuleType, name: str) -> list[str] | None:
    """Return the paths in a module's `DEPENDS`, or None if it has no such list."""
    depends = getattr(module, "DEPENDS", None)
    if depends is None:
        return None
    if isinstance(depends, str) or not isinstance(depends, Iterable):
        raise LoadError(f"DEPENDS of {name} is {depends!r}; expected a list of paths")
    return [str(path) for path in depends]


def _hashed(arguments: list[str], declared: list[str], folder: Path) -> list[tuple[str, str]]:
    """Return path and sha256 of the files that arguments name and of the declared files."""
    named = [Path(value) for value in arguments if os.path.isfile(value)]
    paths = [folder / name for name in declared]
    for path in paths:
        # Reading a device or a pipe might never end.
        if path.exists() and not path.is_file():
            raise LoadError(f"DEPENDS names {path}, which is no regular file")
    try:
        return [(str(path), _file_sha256(path)) for path in (*named, *paths)]
    except OSError as error:
        raise LoadError(str(error)) from None


class _OwnCode:
    """Record of the robot's own code files, each with the sha256 of the bytes that ran."""

    def __init__(self, foreign: list[str]) -> None:
        """Begin to record imports; `foreign` are folders of code that is not the robot's."""
        self._foreign = [Path(folder) for folder in (*foreign, sysconfig.get_paths()["stdlib"])]
        self._ran: dict[str, set[str]] = {}
        self._module: ModuleType | None = None
        usual = SourceFileLoader.get_code

        def get_code(loader: Any, name: str) -> Any:
            if self._is_installed(Path(loader.path).resolve()):
                return usual(loader, name)
            # Read once, so that the hashed bytes are those that run.
            data = loader.get_data(loader.path)
            self._note(loader.path, data)
            return loader.source_to_code(data, loader.path)

        SourceFileLoader.get_code = get_code  # ty: ignore[invalid-assignment]

    def of(self, module: ModuleType) -> None:
        """Set the robot's module: its own code is in the module's folder and the working folder."""
        self._module = module
        self.folder = Path(module.__file__ or "").resolve().parent

    def files(self) -> Mapping[str, list[str]]:
        """Return the code files that ran until now with their hashes, the module's own file first.

        A file has several hashes if it was changed between two loads.
        """
        module_file = Path(getattr(self._module, "__file__", None) or "").resolve()
        paths = [getattr(module, "__file__", None) for module in list(sys.modules.values())]
        # Some files do not exist: PyTorch has a module whose `__file__` is "_classes.py".
        named = {Path(file).resolve() for file in paths if file and file.endswith(".py")}
        named = {file for file in named if file.is_file()} | {Path(file) for file in self._ran}
        files = [module_file, *sorted(file for file in named - {module_file} if self._is_own(file))]
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
    """Import files beside this one in order and return the last; remove their names afterwards.

    The robot's own modules may have the same names.
    """
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
    """Let Linux kill this process when its parent ends, even if this process is stopped."""
    # Other systems have no `prctl`.
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)


def _end_with(parent: int) -> None:
    """End this process after its parent ended, even while a robot's code runs."""
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)


if __name__ == "__main__":
    serve()
