"""What a finished folder's figures were drawn from that lies outside of it, by its bytes.

The manifest names the policies and the registry's entries about them, the files of own robots, and
the kept episodes of reference egos. All that is here is held against it. A folder that was received
comes from another machine: what is not here is told, and is no problem.
"""

import dataclasses
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_base.errors import ZooError, shorten
from evaluation.record import manifest as provenance
from zoo.locations import registry_path
from zoo.locking import used_leaves
from zoo.parameters.storage import load_leaves
from zoo.registry import Registry, load_registry
from zoo.schema import PolicyEntry

LARGEST_SUM = 1 << 32  # bytes of all files that are hashed: a received manifest may name any


@dataclasses.dataclass(frozen=True)
class SourceReport:
    """What a check of a folder's sources found."""

    sources: int  # that are here, and were held against the manifest
    absent: tuple[str, ...]  # what could not be
    problems: tuple[str, ...]


def describe_sources(
    registry: Registry, entries: Sequence[PolicyEntry], split: str | None, files: Iterable[Path]
) -> dict[str, Any]:
    """Return what the manifest says of the sources.

    Args:
        registry: Where the policies are from.
        entries: All policies of it that were played.
        split: The id of the split whose sides are told apart.
        files: Own robots' and other folders'.
    """
    by_release: dict[str, list[PolicyEntry]] = {}
    for entry in entries:
        by_release.setdefault(entry.release, []).append(entry)
    return {
        "registry": str(registry.path.resolve()),
        "split": split,
        "releases": {
            release: {
                "policies": {entry.id: entry.sha256 for entry in played},
                "entries": used_leaves(registry, release, played, [split] if split else []),
            }
            for release, played in by_release.items()
        },
        "files": {str(path.resolve()): provenance.file_sha256(path) for path in files},
    }


def check_sources(folder: Path, registry: Path | None = None) -> SourceReport:
    """Hold what a folder's manifest names, and is here, against its hashes.

    Args:
        folder: A finished folder, received from anybody.
        registry: Where its policies are looked up; if not given, where they were, if that is here,
            else the installed one.
    """
    sources = (provenance.read_manifest(folder) or {}).get("sources")
    if sources is None:
        return SourceReport(0, ("what it was drawn from: its manifest does not name it",), ())
    try:
        found = [*_check_files(sources["files"]), *_check_releases(folder, sources, registry)]
    except (KeyError, TypeError, AttributeError) as error:
        return SourceReport(0, (), (f"{folder}: its manifest names no sources: {error!r}",))
    absent = tuple(text for kind, text in found if kind == "absent")
    problems = tuple(text for kind, text in found if kind == "problem")
    return SourceReport(len(found) - len(absent), absent, problems)


Finding = tuple[str, str]  # "whole", "absent" or "problem", and of what


def _check_files(files: Mapping[str, str]) -> Iterator[Finding]:
    """Hold own robots' and other folders' files against their hashes; each is read once.

    They may lie anywhere. Of a file that is another than expected the hash is not shown: a received
    manifest may name a secret.
    """
    hashes: dict[tuple[int, int], str] = {}
    left = LARGEST_SUM
    for name, digest in files.items():
        path = Path(name)
        try:
            provenance.check_regular(status := path.lstat())
            if (file := (status.st_dev, status.st_ino)) not in hashes:
                left -= status.st_size
                if left < 0:
                    raise OSError(f"beyond the {LARGEST_SUM} bytes that are read")
                hashes[file] = provenance.received_sha256(path)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            yield "absent", f"file {shorten(name)} ({shorten(str(reason))})"
            continue
        if hashes[file] == digest:
            yield "whole", name
        else:
            yield "problem", f"{shorten(name)} is not what the figures are of: another sha256"


def _is_registry(folder: Path, path: Path) -> bool:
    """Return whether a manifest names a registry of this machine's, none that came with it."""
    try:
        provenance.check_regular(path.lstat())
        return path.suffix == ".json" and folder.resolve() not in path.resolve().parents
    except (OSError, ValueError):
        return False


def _check_releases(
    folder: Path, sources: Mapping[str, Any], given: Path | None
) -> Iterator[Finding]:
    recorded = Path(sources["registry"])
    chosen = given or (recorded if _is_registry(folder, recorded) else None)
    in_use = given is None and recorded == registry_path().resolve()  # with what the user added
    try:
        registry = load_registry(None if in_use else chosen)
    except ZooError as error:
        yield "problem", str(error)
        return
    known = {entry.id: entry for entry in registry.policies}
    for release, named in sources["releases"].items():
        has = {name: entry.sha256 for name in named["policies"] if (entry := known.get(name))}
        if chosen is None and has != named["policies"]:
            yield "absent", f"policies of {shorten(str(recorded))}; --registry names another"
            continue
        here, splits = [known[name] for name in has], [sources["split"]] if sources["split"] else []
        now = has
        if release in registry.data.releases:
            now |= used_leaves(registry, release, here, splits)
        for name, digest in {**named["policies"], **named["entries"]}.items():
            told = f"{registry.path}: {shorten(name)} is not what the figures are of"
            yield ("whole" if now.get(name) == digest else "problem"), told
        yield from _check_parameters(registry, here)


def _check_parameters(registry: Registry, entries: Sequence[PolicyEntry]) -> Iterator[Finding]:
    for shard in dict.fromkeys(entry.shard for entry in entries):
        path = registry.shard_path(shard)
        if not path.is_file():
            yield "absent", f"parameters, in {path}"
            continue
        try:
            load_leaves(registry, [entry for entry in entries if entry.shard == shard])
            yield "whole", str(path)
        except ZooError as error:
            yield "problem", str(error)
