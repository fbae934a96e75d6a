"""Locks of folders. They end with their process, even if it is killed."""

import contextlib
import sqlite3
from collections.abc import Generator
from pathlib import Path

from filelock import ReadWriteLock, Timeout

LOCK_FILE = ".lock"


@contextlib.contextmanager
def locked(
    folder: Path, name: str = LOCK_FILE, *, shared: bool = False, wait: bool = False
) -> Generator[None]:
    """Hold a folder's lock. On a file system without locks, hold nothing.

    Args:
        folder: What is written to; it is created.
        name: The lock's file.
        shared: Let others hold it too that ask for it shared; else alone.
        wait: Wait for another process to be done.

    Raises:
        ValueError: Another process holds it, and `wait` is false.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = ReadWriteLock(folder / name, is_singleton=False)
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context((lock.read_lock if shared else lock.write_lock)(blocking=wait))
        except Timeout:
            raise ValueError(
                f"another process is writing to {folder}; wait until it is done, or choose another "
                "folder"
            ) from None
        except sqlite3.OperationalError:
            pass
        yield
