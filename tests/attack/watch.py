"""Sees every write of a process: tells those outside its folders, and kills the process at one.

Python announces what opens, renames, makes and removes files to audit hooks. `os.fsync` is not
among them and is wrapped; a process that dies there leaves half a file, as a power cut would.
"""

import os
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink"}
_CHANGES |= {"os.truncate", "shutil.rmtree", "shutil.move"}
_DEVICES = ("/dev/", "/proc/", "/sys/")


class Watch:
    """The writes of this process from now on; a hook stays as long as its process."""

    def __init__(self, allowed: Sequence[Path], kill_at: int | None = None) -> None:
        self.allowed = [str(path.resolve()) for path in allowed]
        self.kill_at, self.count = kill_at, 0
        self.outside: list[str] = []
        self.on = True
        self._flush = os.fsync
        sys.addaudithook(self._hook)
        os.fsync = self._fsync  # ty: ignore[invalid-assignment]

    def _hook(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self.on:
            return
        if event == "open" and not _writes(arguments):
            return
        if event != "open" and event not in _CHANGES:
            return
        paths = [
            argument
            for argument in arguments[:2]
            if isinstance(argument, str | bytes | os.PathLike)
        ]
        self._see([os.fsdecode(path) for path in (paths[:1] if event == "open" else paths)])

    def _fsync(self, descriptor: int) -> None:
        def tear() -> None:
            self.on = False
            size = os.fstat(descriptor).st_size
            writable = os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY)
            os.ftruncate(writable, size // 2)

        path = os.readlink(f"/proc/self/fd/{descriptor}")
        self._see([path], tear if os.path.isfile(path) else None)
        self._flush(descriptor)

    def _see(self, paths: Sequence[str], before_death: Callable[[], None] | None = None) -> None:
        full = [os.path.abspath(path) for path in paths]
        written = [path for path in full if not path.startswith(_DEVICES)]
        self.outside += [path for path in written if not path.startswith(tuple(self.allowed))]
        self.count += bool(written)
        if self.kill_at is not None and self.count >= self.kill_at:
            if before_death:
                before_death()
            os.kill(os.getpid(), signal.SIGKILL)


def _writes(arguments: tuple[Any, ...]) -> bool:
    path, _, flags = arguments
    changing = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
    return not isinstance(path, int) and bool(flags & changing)
