"""A folder of what was compiled, found by what it was compiled from and trusted by its own hash.

A file is named `<key>-<digest><suffix>`. The key is of all that went in; the digest is of the key
and the bytes together, so that a damaged file, a cut one and one renamed from another key all give
themselves away, are removed, and are compiled anew. Files appear whole, by renaming: processes may
build the same one at the same time, and the last one's stays.
"""

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path


def folder() -> Path:
    """Return this user's folder; others must not write to it, since what lies there is executed."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    path = Path(home, "assistax-zoo", "fused")
    path.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = path.stat()
    if found.st_uid != os.getuid() or found.st_mode & 0o022:
        raise ValueError(
            f"{path} belongs to another user or may be written by others, and machine code is run "
            "from there; remove it, or set XDG_CACHE_HOME to a folder of your own"
        )
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
    with tempfile.TemporaryDirectory(dir=home) as scratch:
        made = Path(scratch, f"made{suffix}")
        build(made)
        path = home / _name(key, suffix, made.read_bytes())
        os.replace(made, path)
    return path


def _name(key: str, suffix: str, data: bytes) -> str:
    digest = hashlib.sha256(key.encode() + data).hexdigest()[:32]
    return f"{key}-{digest}{suffix}"
