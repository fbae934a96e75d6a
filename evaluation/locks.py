"""One folder, one writer: advisory locks that end with their process, even a killed one."""

import contextlib
import errno
import fcntl
from collections.abc import Generator
from pathlib import Path

LOCK_FILE = ".lock"
_UNSUPPORTED = (
    errno.ENOLCK,
    errno.ENOTSUP,
    errno.ENOSYS,
)  # a file system without locks goes without


@contextlib.contextmanager
def locked(
    folder: Path, name: str = LOCK_FILE, *, shared: bool = False, wait: bool = False
) -> Generator[None]:
    """Hold a folder's lock.

    Args:
        folder: What is written to; it is created.
        name: The lock's file.
        shared: Let others hold it too that ask for it shared; else alone.
        wait: Wait for another process to be done.

    Raises:
        ValueError: Another process holds it, and `wait` is false.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / name, "a") as file:
        mode = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | (0 if wait else fcntl.LOCK_NB)
        try:
            fcntl.flock(file, mode)
        except BlockingIOError:
            raise ValueError(
                f"another process is writing to {folder}; wait until it is done, or choose another "
                "--out"
            ) from None
        except OSError as error:
            if error.errno not in _UNSUPPORTED:
                raise
        yield
