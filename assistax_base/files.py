"""Atomic writes: readers see a file whole or not at all. Imports nothing heavy.

`atomic_write` takes bytes, `atomic_path` lends a path for writers that want one (Polars, a zip).
Both flush to disk before the rename, so that a power cut leaves the old file or the new one.
A killed writer leaves a hidden `.NAME.*.tmp`; the next write of the same name removes it once it
is an hour old, since a younger one may be another process's.
"""

import contextlib
import glob
import json
import os
import secrets
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

from filelock import FileLock

STALE_SECONDS = 3600.0
# Under which our files keep JSON about themselves: safetensors, Parquet, ONNX. It is the only key,
# since the bytes of safetensors are stable with at most one.
METADATA_KEY = "assistax"


@contextlib.contextmanager
def atomic_path(path: Path) -> Generator[Path]:
    """Lend a hidden sibling of `path` to write; on leaving without an error it becomes `path`.

    Raises:
        OSError: The folder or the file, which it names, cannot be written; `path` is as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and not path.is_file():
        raise OSError(f"{path} is not a regular file; it is not replaced")
    remove_stale(path.parent, f".{glob.escape(path.name)}.*.tmp")
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        yield temporary
        _flush(temporary)
        os.replace(temporary, path)
    except OSError as error:
        if error.errno and not error.filename:  # as from a full disk
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # Windows cannot open folders; there is nothing to flush
        _flush(path.parent)


ANYBODY, OWNER = 0o666, 0o600  # who may read a file, as far as the process's mask allows


def atomic_write(path: Path, data: bytes, mode: int = ANYBODY) -> None:
    """Replace the content of `path` by `data`, whole or not at all.

    Of a secret no other user sees a byte at any moment: its mode is `OWNER` before it is written.
    """
    with atomic_path(path) as temporary:
        temporary.touch(mode=mode)
        temporary.write_bytes(data)


def write_json(path: Path, content: Any) -> None:
    """Replace the content of `path` by JSON that people may read, whole or not at all."""
    atomic_write(path, (json.dumps(content, indent=2) + "\n").encode())


def remove_stale(folder: Path, pattern: str, age: float = STALE_SECONDS) -> None:
    """Remove temporary files that a killed process left, by their glob, once they are old."""
    for file in folder.glob(pattern):
        with contextlib.suppress(OSError):
            if time.time() - file.stat().st_mtime > age:
                file.unlink()


def exclusive(path: Path) -> FileLock:
    """Return a lock, a context manager, for whoever reads, changes and replaces the file `path`.

    A second one waits for the first; a killed one lets go.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    return FileLock(path.with_name(f".{path.name}.lock"))


def _flush(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
