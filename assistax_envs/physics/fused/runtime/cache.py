"""A folder of what was compiled, found by what it was compiled from and trusted by its own hash.

A file is named `<key>-<digest><suffix>`. The key is of all that went in; the digest is of the key
and the bytes together, so that a damaged file, a cut one and one renamed from another key all give
themselves away, are removed, and are compiled anew. Files appear whole, by renaming: processes may
build the same one at the same time, and the last one's stays.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable, Generator, Iterable
from pathlib import Path

from assistax_envs import compiled


def folder() -> Path:
    """Return this user's folder; others must not write to it, since what lies there is executed."""
    path = compiled.folder()
    with _writing(path):
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
    if reason := compiled.refused(path):
        raise ValueError(reason)
    return path


def key(parts: Iterable[bytes]) -> str:
    """Return the key of what is compiled from `parts`; where one part ends counts."""
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()[:32]


def cached(key: str, suffix: str, build: Callable[[Path], None]) -> Path:
    """Return the file of `key`, written by `build` to the path it is given where none is sound."""
    home = folder()
    for path in home.glob(f"{key}-*{suffix}"):
        if path.name == _name(key, suffix, path.read_bytes()):
            return path
        path.unlink(missing_ok=True)
    with _writing(home), tempfile.TemporaryDirectory(dir=home) as scratch:
        made = Path(scratch, f"made{suffix}")
        build(made)
        path = home / _name(key, suffix, made.read_bytes())
        os.replace(made, path)
    return path


@contextlib.contextmanager
def _writing(path: Path) -> Generator[None]:
    """Say of a folder that is read-only or full where it is, and how to have another."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"cannot keep compiled programs in {path} ({error.strerror or error}); set "
            f"{compiled.VARIABLE} to a folder that can be written, or choose another backend"
        ) from error


def _name(key: str, suffix: str, data: bytes) -> str:
    digest = hashlib.sha256(key.encode() + data).hexdigest()[:32]
    return f"{key}-{digest}{suffix}"
