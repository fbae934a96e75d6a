"""Where fetched bytes lie: one folder for all registries, each file named by the sha256 that a registry records.

    shards/<sha256>.safetensors    whole shards
    rows/<sha256>.safetensors      single policies cut out of a shard, by the sha256 of the row
    registries/<remote>/registry.json

A file of that name is complete: it is written as a hidden sibling, hashed, and renamed.
"""

import errno
import hashlib
import os
import re
import shutil
from pathlib import Path
from typing import NoReturn

from zoo.errors import CacheError

CACHE_VARIABLE = "ASSISTAX_ZOO_CACHE"


def cache_root() -> Path:
    """Return the cache folder: `$ASSISTAX_ZOO_CACHE`, or `assistax-zoo` in the user's cache folder."""
    if os.environ.get(CACHE_VARIABLE):
        return Path(os.environ[CACHE_VARIABLE])
    return Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"), "assistax-zoo")


def cached_shard(digest: str) -> Path:
    """Return where the shard with that sha256 lies if it was fetched."""
    return cache_root() / "shards" / f"{digest}.safetensors"


def cached_row(digest: str) -> Path:
    """Return where the policy with that row sha256 lies if it was fetched on its own."""
    return cache_root() / "rows" / f"{digest}.safetensors"


def cached_registry(remote: str) -> Path:
    """Return where the registry of a remote lies if it was fetched; the name is the user's for it."""
    words = re.sub(r"[^A-Za-z0-9.]+", "-", remote).strip("-.")[-60:]
    return (
        cache_root()
        / "registries"
        / f"{words}-{hashlib.sha256(remote.encode()).hexdigest()[:8]}"
        / "registry.json"
    )


def refuse_write(error: OSError, path: Path, size: int) -> NoReturn:
    """Raise the error for bytes that the cache could not take.

    Raises:
        CacheError: Always; it says how much room there is when the disk is full.
    """
    full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
    raise CacheError(
        f"cache {path.parent}",
        expected=f"room for {size} bytes" if full else "a folder that can be written",
        found=f"{error.strerror or error}{_room(path) if full else ''}",
        done="nothing was added; complete files are untouched",
        next_step=f"{'free some space' if full else 'allow writing'}, or choose another folder with ${CACHE_VARIABLE}",
    ) from None


def _room(path: Path) -> str:
    try:
        return f" ({shutil.disk_usage(path.parent).free} bytes free)"
    except OSError:
        return ""
