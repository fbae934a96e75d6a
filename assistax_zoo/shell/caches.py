"""Kinds of cached files: place, size and removal.

Only files that have the names which this package gives them are counted and removed. So nothing of
the user's is lost where the cache was pointed at a folder that holds other things too.
"""

import contextlib
import dataclasses
import os
import re
import shutil
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from assistax_base.errors import listing
from assistax_envs import compiled
from zoo.locations import CACHE_VARIABLE, cache_root

_HIDDEN = r"\..+\.(partial|tmp)"  # what a killed process left


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of cached files."""

    name: str
    what: str  # and what its loss costs
    folder: Callable[[], Path]
    names: re.Pattern[str]  # of what it holds, in full
    asked: bool = False  # removed only if it is named


def _within(name: str) -> Callable[[], Path]:
    return lambda: cache_root() / name


KINDS = {
    kind.name: kind
    for kind in (
        Kind(
            "shards",
            "fetched parameters; they are fetched again",
            _within("shards"),
            re.compile(rf"[0-9a-f]{{64}}\.safetensors|{_HIDDEN}"),
        ),
        Kind(
            "registries",
            "what remotes published; without it a rewritten history is not noticed",
            _within("registries"),
            re.compile(r".*-[0-9a-f]{8}"),
            asked=True,
        ),
        Kind(
            "references",
            "episodes of robots to compare with; they are played again",
            _within("references"),
            re.compile(r"[0-9a-f]{20}"),
        ),
        Kind(
            "xla",
            "programs that JAX compiled; they are compiled again",
            _within("xla"),
            re.compile(r".+-(cache|atime)"),
        ),
        Kind(
            "fused",
            "programs of the fused engine, and persons' numbers; they are made again",
            compiled.folder,
            re.compile(r"[0-9a-f]{32}-[0-9a-f]{32}\.(o|cubin|npy)"),
        ),
    )
}


@dataclasses.dataclass(frozen=True)
class Held:
    """Number and size of the cached files of a kind."""

    kind: str
    what: str
    folder: str
    files: int
    bytes: int


def held(kind: str) -> Held:
    """Return the number and size of the cached files of a kind. A link counts as itself."""
    files = [file for entry in _entries(KINDS[kind]) for file in _files(entry)]
    sizes = [size for file in files if (size := _size(file)) is not None]
    place = KINDS[kind]
    return Held(kind, place.what, str(place.folder()), len(sizes), sum(sizes))


def chosen_kinds(names: Sequence[str] = ()) -> list[str]:
    """Return the named kinds; without names, all kinds whose files can be made again.

    Raises:
        ValueError: There is no such kind.
    """
    if unknown := [name for name in names if name not in KINDS]:
        raise ValueError(f"no kind of cache is named {unknown[0]!r}; there are {listing(KINDS)}")
    return [name for name, kind in KINDS.items() if (name in names if names else not kind.asked)]


def clean(kind: str) -> tuple[Held, list[str]]:
    """Remove the cached files of a kind.

    Returns:
        What was removed, and the paths of what was not: another process writes to it.

    Raises:
        OSError: Something cannot be removed; it is named.
    """
    before, busy = held(kind), []
    for path in _entries(KINDS[kind]):
        if path.is_dir() and not path.is_symlink():
            if not _remove_folder(path):
                busy.append(str(path))
        else:
            path.unlink(missing_ok=True)
    after = held(kind)
    removed = {"files": before.files - after.files, "bytes": before.bytes - after.bytes}
    return dataclasses.replace(before, **removed), busy


def warn_once() -> None:
    """Warn in one line that this process cannot cache compiled programs.

    JAX warns of every program, and names neither a remedy nor us. A program that was kept in part,
    because the disk was full or its writer was killed, it would never replace: that one is removed.
    """
    shown, warned = warnings.showwarning, False

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        nonlocal warned
        text, place = str(message), os.environ.get("JAX_COMPILATION_CACHE_DIR", "")
        if "persistent compilation cache entry" not in text:
            shown(message, category, *where, **more)
        elif torn := [
            path
            for name in re.findall(r"Error reading persistent .* entry for '(\w+)'", text)
            for path in Path(place).glob(f"{name}-*-cache")
        ]:
            with contextlib.suppress(OSError):  # nor can it be removed: compiled each time
                for path in torn:
                    path.unlink(missing_ok=True)
        elif not warned:
            warned = True
            reason = text.rpartition("] ")[2].partition(":")[0]
            print(
                f"warning: compiled programs are not kept in {place} ({reason}); choose another "
                f"cache with ${CACHE_VARIABLE}",
                file=sys.stderr,
            )

    warnings.showwarning = show  # ty: ignore[invalid-assignment]


def _remove_folder(path: Path) -> bool:
    """Remove a folder unless another process holds its lock; return whether it is gone."""
    from assistax_base.locks import locked

    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(path))
        except ValueError:
            return False
        shutil.rmtree(path)
    return True


def _entries(kind: Kind) -> list[Path]:
    """Return the entries directly in a kind's folder that have a name of ours."""
    try:
        return sorted(path for path in kind.folder().iterdir() if kind.names.fullmatch(path.name))
    except (FileNotFoundError, NotADirectoryError):
        return []


def _files(path: Path) -> list[Path]:
    if path.is_symlink() or not path.is_dir():
        return [path]
    return [Path(root, name) for root, _, names in os.walk(path) for name in names]


def _size(path: Path) -> int | None:
    try:
        return path.lstat().st_size
    except OSError:  # it is gone by now
        return None
