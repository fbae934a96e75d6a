"""A small disk in memory for the board of a rehearsal, so that it can be filled to the last byte.

A file system of its own (tmpfs) is the only honest way: writes fail with ENOSPC for every process
that uses it, and nothing else on this machine runs short. Where none may be mounted, as for most
users who are not root, the full disk is left out, and the rehearsal says so.
"""

import contextlib
import errno
import shutil
import subprocess
import time
from collections.abc import Generator
from pathlib import Path
from typing import IO

SMALL = "size=64m,mode=0700"


@contextlib.contextmanager
def small_disk(folder: Path) -> Generator[bool]:
    """Make a folder on a small file system, or on this one; say which. At the end it is copied.

    Yields:
        Whether it is a small file system.
    """
    folder.mkdir(mode=0o700, parents=True)
    words = ["mount", "-t", "tmpfs", "-o", SMALL, "tmpfs", str(folder)]
    try:
        is_small = subprocess.run(words, capture_output=True).returncode == 0
    except OSError:  # there is no such command
        is_small = False
    kept = folder.with_name(f"{folder.name}-kept")
    try:
        yield is_small
    finally:
        if is_small:
            shutil.copytree(folder, kept)
            subprocess.run(["umount", "--lazy", str(folder)], check=True)
            folder.rmdir()
            kept.rename(folder)


@contextlib.contextmanager
def full_disk(folder: Path) -> Generator[None]:
    """Leave no byte on the file system of a folder while the block runs.

    It is filled three times: others give something back meanwhile.

    Raises:
        ValueError: It is not full: another limit came first.
    """
    path = folder / "filler"
    try:
        with path.open("wb", buffering=0) as file:
            for _ in range(3):
                _fill(file)
                time.sleep(0.5)
        yield
    finally:
        path.unlink(missing_ok=True)


def _fill(file: IO[bytes]) -> None:
    try:
        while True:
            file.write(bytes(4096))
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise ValueError(f"the disk could not be filled: {error}") from error
