"""Cache of compiled programs in a folder, found by the hash of their sources.

A file is named `<key>-<digest><suffix>`. The key is the hash of all inputs. The digest is the hash
of the key and the bytes together, so that a damaged, truncated or renamed file is detected, removed
and compiled anew. Files appear whole, by renaming: processes may build the same file at the same
time, and the last one stays.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable, Generator, Iterable
from pathlib import Path

from assistax_envs import compiled


def folder() -> Path:
    """Return this user's folder; others must not be able to write to it, as its files are run."""
    path = compiled.folder()
    with _writing(path):
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
    if reason := compiled.refused(path):
        raise ValueError(reason)
    return path


def key(parts: Iterable[bytes]) -> str:
    """Return the key of a program compiled from `parts`; the bounds of the parts count."""
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()[:32]


def cached(key: str, suffix: str, build: Callable[[Path], None]) -> Path:
    """Return the intact file of `key`; if there is none, `build` writes it to the given path."""
    cache_folder = folder()
    for path in cache_folder.glob(f"{key}-*{suffix}"):
        if path.name == _name(key, suffix, path.read_bytes()):
            return path
        path.unlink(missing_ok=True)
    with _writing(cache_folder), tempfile.TemporaryDirectory(dir=cache_folder) as scratch:
        built = Path(scratch, f"made{suffix}")
        build(built)
        path = cache_folder / _name(key, suffix, built.read_bytes())
        os.replace(built, path)
    return path


@contextlib.contextmanager
def _writing(path: Path) -> Generator[None]:
    """Raise an OSError with the folder and a remedy if the folder is read-only or full."""
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
