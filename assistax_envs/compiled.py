"""Cache of compiled programs and other things built from sources, in a folder of this user alone.

A file is named `<key>-<digest><suffix>`. The key is the hash of all inputs. The digest is the hash
of the key and the bytes together, so that a damaged, truncated or renamed file is detected, removed
and built anew. Files appear whole, by renaming: processes may build the same file at the same time,
and the last one stays. Imports nothing heavy.
"""

import contextlib
import hashlib
import os
import tempfile
from collections.abc import Callable, Generator, Iterable
from pathlib import Path

VARIABLE = "XDG_CACHE_HOME"


def folder() -> Path:
    """Return this user's folder of compiled programs, which need not exist.

    Partners have another cache, which users may share: machine code that others can write is
    unsafe.
    """
    home = os.environ.get(VARIABLE) or os.path.expanduser("~/.cache")
    return Path(home, "assistax-zoo", "fused")


def refused(path: Path) -> str | None:
    """Return the reason not to run code of an existing folder; None if it is this user's alone."""
    status = path.stat()
    if status.st_uid == os.getuid() and not status.st_mode & 0o022:
        return None
    return (
        f"{path} belongs to another user or may be written by others, and machine code is run "
        f"from there; remove it, or set {VARIABLE} to a folder of your own"
    )


def key(parts: Iterable[bytes]) -> str:
    """Return the key of a file that is built from `parts`; the bounds of the parts count."""
    whole = hashlib.sha256()
    for part in parts:
        whole.update(hashlib.sha256(part).digest())
    return whole.hexdigest()[:32]


def cached(key: str, suffix: str, build: Callable[[Path], None]) -> Path:
    """Return the intact file of `key`; if there is none, `build` writes it to the given path.

    Raises:
        OSError: The folder cannot be written.
        ValueError: Others may write to the folder.
    """
    own = _own_folder()
    for path in own.glob(f"{key}-*{suffix}"):
        if path.name == _name(key, suffix, path.read_bytes()):
            return path
        path.unlink(missing_ok=True)
    with _writing(own), tempfile.TemporaryDirectory(dir=own) as scratch:
        built = Path(scratch, f"made{suffix}")
        build(built)
        path = own / _name(key, suffix, built.read_bytes())
        os.replace(built, path)
    return path


def _own_folder() -> Path:
    """Return the folder, made if needed; others must not be able to write to it."""
    path = folder()
    with _writing(path):
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
    if reason := refused(path):
        raise ValueError(reason)
    return path


@contextlib.contextmanager
def _writing(path: Path) -> Generator[None]:
    """Raise an OSError with the folder and a remedy if the folder is read-only or full."""
    try:
        yield
    except OSError as error:
        raise OSError(
            f"cannot keep compiled programs in {path} ({error.strerror or error}); set "
            f"{VARIABLE} to a folder that can be written, or choose another backend"
        ) from error


def _name(key: str, suffix: str, data: bytes) -> str:
    digest = hashlib.sha256(key.encode() + data).hexdigest()[:32]
    return f"{key}-{digest}{suffix}"
