"""Compare a folder's files and sources with the hashes in its manifest.

All files of a finished folder must exist and have their hashes. Its sources are elsewhere: those of
a received folder may be on another machine, so absent sources are reported but are no problem.
Files that a received manifest names are read within bounds.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import polars as pl

from assistax_base.errors import ZooError, lacks_memory, printable, shorten
from assistax_base.parquet import check_readable
from evaluation.record import tables
from evaluation.record.manifest import (
    MANIFEST_FILE,
    check_ours,
    check_regular,
    identity_digest,
    our_files,
    read_manifest,
    received_sha256,
)
from zoo.locations import registry_path
from zoo.locking import used_leaves
from zoo.parameters.storage import load_leaves
from zoo.registry import Registry, load_registry
from zoo.schema import PolicyEntry

LARGEST_SUM = 1 << 32  # bytes of all hashed files together: a received manifest may name any file


@dataclasses.dataclass(frozen=True)
class Leaf:
    """A hash in a manifest, and the hash of the content found under its name."""

    name: str
    expected: str
    actual: str | None  # None if the content is missing or unreadable
    error: Exception | None = None  # the error of reading it


def compare(named: Mapping[str, str], digest: Callable[[str], str | None]) -> Iterator[Leaf]:
    """Yield a leaf for each name of a manifest, with the hash that `digest` returns for it."""
    for name, expected in named.items():
        try:
            yield Leaf(name, expected, digest(name))
        except (OSError, ValueError) as error:
            yield Leaf(name, expected, None, error)


@dataclasses.dataclass(frozen=True)
class FolderReport:
    """Result of checking a folder, or its sources, against its manifest."""

    folder: str
    files: int = 0  # number of checked files of the folder
    sources: int = 0  # number of checked sources
    absent: tuple[str, ...] = ()  # sources that are not here
    problems: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether no file or source has another content."""
        return not self.problems


def check_whole(folder: Path) -> None:
    """Check a finished folder against its manifest before figures are made from it.

    A folder without a manifest passes, but its tables must be readable: a sender can write a
    manifest that fits damaged tables. The picture of the matrix is not checked, because it is not a
    source and may have been drawn again.

    Raises:
        ValueError: A file was changed, damaged or lost.
    """
    listed = (read_manifest(folder) or {}).get("files", {})
    if not isinstance(listed, dict):
        raise ValueError(f"{folder / MANIFEST_FILE} is damaged; run again")
    sources = {name: digest for name, digest in listed.items() if name != tables.MATRIX_FIGURE}
    if problem := next(_file_problems(folder, sources), None):
        raise ValueError(f"{problem}; take the folder from where it was made, or run again")
    for path in (files := our_files(folder)):
        check_ours(path)
    check_readable([path for path in files if path.suffix == ".parquet"])


@contextlib.contextmanager
def strange_tables_refused(folder: Path, *others: type[Exception]) -> Generator[None]:
    """Turn errors of reading malformed tables or fields in a `with` block into a ValueError.

    A received folder can have right hashes and malformed tables.

    Args:
        folder: The folder that is read.
        others: More exception types that malformed content causes.
    """
    try:
        yield
    except (
        *(ArithmeticError, AttributeError, LookupError, TypeError),
        *(pl.exceptions.PolarsError, *others),
    ) as error:
        if lacks_memory(error):
            raise
        raise ValueError(
            f"{folder} is damaged, or of another version ({shorten(error)}); run again"
        ) from None


def unchecked(folder: Path) -> list[str]:
    """Return a note on files that no manifest lists, so that `check_whole` did not check them."""
    names = [path.name for path in our_files(folder)]
    manifest = read_manifest(folder)
    if manifest is None:
        return [f"{folder} has no {MANIFEST_FILE}: nothing of it was checked"]
    unknown = [name for name in names if name not in manifest.get("files", {})]
    note = f"not in the {MANIFEST_FILE} of {folder}, hence not checked: {', '.join(unknown)}"
    return [note] if unknown else []


def verify_folder(folder: Path) -> FolderReport:
    """Return the report on all files of a finished, untrusted folder against its manifest."""
    try:
        manifest = read_manifest(folder)
    except (ValueError, OSError) as error:
        return FolderReport(str(folder), problems=(str(error),))
    if manifest is None or not isinstance(manifest.get("files"), dict):
        problem = f"{folder} has no {MANIFEST_FILE} of a finished run; run the command again"
        return FolderReport(str(folder), problems=(problem,))
    files = manifest["files"]
    problems = [*_file_problems(folder, files)]
    unknown = [path.name for path in our_files(folder) if path.name not in files]
    problems += [f"{folder / name} is not in the manifest" for name in unknown]
    problems = problems or _table_problems(folder, manifest)
    return FolderReport(str(folder), len(files), problems=tuple(problems))


def check_sources(folder: Path, registry: Path | None = None) -> FolderReport:
    """Return the report on a folder's sources that are here, against the manifest's hashes.

    Args:
        folder: A finished, untrusted folder.
        registry: The registry file for its policies. By default the file that the manifest names,
            if it exists, else the installed registry.
    """
    sources = (read_manifest(folder) or {}).get("sources")
    if sources is None:
        absent = "what it was drawn from: its manifest does not name it"
        return FolderReport(str(folder), absent=(absent,))
    try:
        findings = [*_check_files(sources["files"]), *_check_releases(folder, sources, registry)]
    except (KeyError, TypeError, AttributeError) as error:
        problem = f"{folder}: its manifest names no sources: {error!r}"
        return FolderReport(str(folder), problems=(problem,))
    absent = tuple(text for kind, text in findings if kind == "absent")
    problems = tuple(text for kind, text in findings if kind == "problem")
    return FolderReport(str(folder), 0, len(findings) - len(absent), absent, problems)


Finding = tuple[Literal["whole", "absent", "problem"], str]  # the result for a source, and its name


def _check_files(files: Mapping[str, str]) -> Iterator[Finding]:
    """Yield the finding on each file outside the registry; each file is read once.

    The files may be anywhere. The hash of a differing file is not shown, because a received
    manifest may name a secret file.
    """
    hashes: dict[tuple[int, int], str] = {}
    left = LARGEST_SUM

    def digest(name: str) -> str:
        nonlocal left
        check_regular(status := Path(name).lstat())
        if (file := (status.st_dev, status.st_ino)) not in hashes:
            left -= status.st_size
            if left < 0:
                raise OSError(f"beyond the {LARGEST_SUM} bytes that are read")
            hashes[file] = received_sha256(Path(name))
        return hashes[file]

    for leaf in compare(files, digest):
        name = shorten(leaf.name)
        if leaf.error:
            reason = getattr(leaf.error, "strerror", None) or leaf.error
            yield "absent", f"file {name} ({shorten(str(reason))})"
        elif leaf.actual == leaf.expected:
            yield "whole", name
        else:
            yield "problem", f"{name} is not what the figures are of: another sha256"


def _is_registry(folder: Path, path: Path) -> bool:
    """Return whether `path` is a registry file outside the received folder."""
    try:
        check_regular(path.lstat())
        return path.suffix == ".json" and folder.resolve() not in path.resolve().parents
    except (OSError, ValueError):
        return False


def _check_releases(
    folder: Path, sources: Mapping[str, Any], registry_file: Path | None
) -> Iterator[Finding]:
    """Yield the findings on each release's policies, entries and parameters in a registry."""
    recorded = Path(sources["registry"])
    chosen = registry_file or (recorded if _is_registry(folder, recorded) else None)
    # The registry in use includes added registries.
    in_use = registry_file is None and recorded == registry_path().resolve()
    try:
        registry = load_registry(None if in_use else chosen)
    except ZooError as error:
        yield "problem", str(error)
        return
    for release, named in sources["releases"].items():
        entries = registry.known(named["policies"])
        hashes = {entry.id: entry.sha256 for entry in entries}
        if chosen is None and hashes != named["policies"]:
            text = f"policies of {shorten(str(recorded))}; another registry may have them"
            yield "absent", text
            continue
        if release in registry.data.releases:
            splits = [sources["split"]] if sources["split"] else []
            hashes |= used_leaves(registry, release, entries, splits)
        for leaf in compare({**named["policies"], **named["entries"]}, hashes.get):
            text = f"{registry.path}: {shorten(leaf.name)} is not what the figures are of"
            yield ("whole" if leaf.actual == leaf.expected else "problem"), text
        yield from _check_parameters(registry, entries)


def _check_parameters(registry: Registry, entries: Sequence[PolicyEntry]) -> Iterator[Finding]:
    for shard in dict.fromkeys(entry.shard for entry in entries if entry.shard):
        path = registry.shard_path(shard)
        if not path.is_file():
            yield "absent", f"parameters, in {path}"
            continue
        try:
            load_leaves(registry, [entry for entry in entries if entry.shard == shard])
            yield "whole", str(path)
        except ZooError as error:
            yield "problem", str(error)


def _file_problems(folder: Path, named: Mapping[str, str]) -> Iterator[str]:
    """Yield a problem for each file that differs from the manifest; read only inside the folder."""

    def digest(name: str) -> str | None:
        return received_sha256(folder / name) if Path(name).name == name else None

    for leaf in compare(named, digest):
        path = folder / printable(leaf.name)
        if Path(leaf.name).name != leaf.name:
            yield f"the manifest names {shorten(leaf.name)}, which is no file of {folder}"
        elif isinstance(leaf.error, FileNotFoundError):
            yield f"{path} is missing"
        elif leaf.error:
            yield f"{path} cannot be checked: {printable(str(leaf.error))}"
        elif leaf.actual != leaf.expected:
            yield f"{path}: expected sha256 {shorten(leaf.expected)}, found {leaf.actual}"


def _table_problems(folder: Path, manifest: Mapping[str, Any]) -> list[str]:
    """Return problems of the episode table: other policies or episodes than the manifest's job."""
    path = folder / tables.EPISODES_FILE
    try:
        check_readable([path])
        identity = manifest["identity"]
        if manifest["job"] != identity_digest(identity):
            return [f"{folder / MANIFEST_FILE} names another job than the identity it holds"]
        table = tables.read_episodes(path)
        egos, partners = ([row[0] for row in identity[seat]] for seat in ("egos", "partners"))
        episodes, paired = identity["episodes"], identity["paired"]
        if type(episodes) is not int or not 0 < episodes <= table.height:
            return [f"{path} has other episodes than the manifest"]
        expected = {"ego": set(egos), "partner": set(partners), "episode": set(range(episodes))}
    except (ValueError, OSError, KeyError, TypeError, IndexError) as error:
        return [f"{folder}: {type(error).__name__}: {error}"]
    problems = [
        f"{path} has other {name}s than the manifest"
        for name, values in expected.items()
        if set(table[name]) != values
    ]
    rows = (1 if paired else len(egos)) * len(partners) * episodes
    doubled = table.height - table.select("ego", "partner", "episode").n_unique()
    if not problems and (doubled or table.height != rows):
        problems = [
            f"{path} has {table.height} rows, {doubled} of them twice; the manifest's job: {rows}"
        ]
    return problems
