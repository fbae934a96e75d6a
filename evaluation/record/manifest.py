"""Where a folder's figures come from: its manifest, by whose hashes every file of it is checked.

`manifest.json` holds the job's identity (policies and partners by the hash of their parameters,
environment, engine, versions), its digest, how it was made, and the sha256 of every file that was
drawn from it. It has a hash of its own, so that no bit of it can change unseen either.
"""

import dataclasses
import datetime
import functools
import hashlib
import importlib.metadata
import os
import platform
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from assistax_base.digest import json_sha256
from assistax_base.errors import printable, shorten
from assistax_base.parquet import check_readable
from evaluation.record import tables

MANIFEST_FILE = "manifest.json"
LARGEST = 1 << 30  # bytes of a file that is hashed: a received manifest may name any
PACKAGES = (
    "assistax-zoo",
    "jax",
    "jaxlib",
    "mujoco",
    "mujoco-mjx",
    "flax",
    "numpy",
    "polars",
    "scipy",
)


@dataclasses.dataclass(frozen=True)
class FolderReport:
    """What a check of a folder against its manifest found."""

    folder: str
    files: int  # whose hashes were held against the manifest
    problems: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether every byte is the one that was written."""
        return not self.problems


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file's bytes."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_regular(status: os.stat_result) -> None:
    """Refuse a link, a pipe, a device, what the kernel makes up, and what is larger than ours.

    Raises:
        OSError: Says which.
    """
    if not stat.S_ISREG(status.st_mode) or status.st_dev in _made_up():
        raise OSError("no regular file")
    if status.st_size > LARGEST:
        raise OSError(f"larger than {LARGEST} bytes")


@functools.cache
def _made_up() -> set[int]:
    """Return the file systems whose files are written while they are read, some without end."""
    places = [place for place in ("/proc", "/sys") if os.path.ismount(place)]
    return {os.stat(place).st_dev for place in places}


def received_sha256(path: Path) -> str:
    """Return the sha256 of a file that somebody else may have named or sent.

    It is read for as long as its size says, and no further.

    Raises:
        OSError: It is no regular file (a link, a pipe, a device), or larger than `LARGEST`.
    """
    check_regular(path.lstat())  # opening a device may do something
    flags = (getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOFOLLOW", "O_BINARY"))
    with os.fdopen(os.open(path, os.O_RDONLY | sum(flags)), "rb") as file:
        status = os.fstat(file.fileno())
        check_regular(status)
        digest, left = hashlib.sha256(), status.st_size
        while left and (data := file.read(min(left, 1 << 20))):
            digest.update(data)
            left -= len(data)
    return digest.hexdigest()


def identity_digest(identity: Any) -> str:
    """Return the sha256 of what decides a result, JSON-ready, such as a job's identity."""
    return json_sha256(identity, spaced=True)


def write_manifest(folder: Path, content: Mapping[str, Any]) -> None:
    """Write a manifest with its own hash."""
    bare = {name: value for name, value in tables.to_json(content).items() if name != "sha256"}
    tables.write_json({**bare, "sha256": identity_digest(bare)}, folder / MANIFEST_FILE)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return a folder's manifest, or None where there is none.

    Raises:
        ValueError: it is not what was written.
    """
    path = folder / MANIFEST_FILE
    if not os.path.lexists(path):
        return None
    _check_ours(path)
    found = tables.read_json(path)
    bare = {name: value for name, value in found.items() if name != "sha256"}
    if found.get("sha256") != identity_digest(bare):
        raise ValueError(
            f"{path} was changed after it was written: its sha256 is another; take the folder from "
            "where it was made, or choose another --out"
        )
    return found


def is_readable(folder: Path) -> bool:
    """Return whether a folder's manifest is what was written, or is not there."""
    try:
        read_manifest(folder)
    except ValueError:
        return False
    return True


def seal(folder: Path, **context: Any) -> None:
    """Write the sha256 of every file of ours in a folder into its manifest.

    Args:
        folder: A finished folder.
        context: What else the files depend on, such as the machine or the registry's root.
    """
    files = {path.name: file_sha256(path) for path in _files(folder)}
    write_manifest(folder, {**(read_manifest(folder) or {}), **context, "files": files})


def table_hashes(folder: Path) -> dict[str, str]:
    """Return what a folder's manifest says of its tables: the same job and options give the same.

    Not of what tells how a run went: the summary, the command, and the matrix's picture.
    """
    files = (read_manifest(folder) or {}).get("files", {})
    run = (tables.SUMMARY_FILE, tables.RUN_FILE, tables.MATRIX_FIGURE)
    return {name: digest for name, digest in files.items() if name not in run}


def has_whole(folder: Path, name: str) -> bool:
    """Return whether a finished folder's file has the hash that the manifest holds of it."""
    path = folder / name
    recorded = (read_manifest(folder) or {}).get("files", {}).get(name)
    return path.is_file() and recorded == file_sha256(path)


def check_whole(folder: Path) -> None:
    """Refuse to draw figures from a finished folder that is not what its manifest says.

    A folder without a manifest passes: nobody says what it was. But its tables must be readable:
    whoever sends a folder can write a manifest that fits damaged ones. The matrix's picture is
    nobody's source, and may have been drawn again.

    Raises:
        ValueError: A file was changed, damaged or lost.
    """
    listed = (read_manifest(folder) or {}).get("files", {})
    if not isinstance(listed, dict):
        raise ValueError(f"{folder / MANIFEST_FILE} is damaged; run again")
    sources = {name: digest for name, digest in listed.items() if name != tables.MATRIX_FIGURE}
    for name, digest in sources.items():
        if problem := _file_problem(folder, name, digest):
            raise ValueError(f"{problem}; take the folder from where it was made, or run again")
    for path in (files := _files(folder)):
        _check_ours(path)
    check_readable([path for path in files if path.suffix == ".parquet"])


def unchecked(folder: Path) -> list[str]:
    """Say which files of ours no manifest speaks of, so that `check_whole` checked nothing."""
    names = [path.name for path in _files(folder)]
    manifest = read_manifest(folder)
    if manifest is None:
        return [f"{folder} has no {MANIFEST_FILE}: nothing of it was checked"]
    unknown = [name for name in names if name not in manifest.get("files", {})]
    told = f"not in the {MANIFEST_FILE} of {folder}, hence not checked: {', '.join(unknown)}"
    return [told] if unknown else []


def verify_folder(folder: Path) -> FolderReport:
    """Hold every file of a finished folder, received from anybody, against its manifest."""
    try:
        manifest = read_manifest(folder)
    except (ValueError, OSError) as error:
        return FolderReport(str(folder), 0, (str(error),))
    if manifest is None or not isinstance(manifest.get("files"), dict):
        problem = f"{folder} has no {MANIFEST_FILE} of a finished run; run the command again"
        return FolderReport(str(folder), 0, (problem,))
    files = manifest["files"]
    problems = [_file_problem(folder, name, digest) for name, digest in files.items()]
    unknown = [path.name for path in _files(folder) if path.name not in files]
    problems += [f"{folder / name} is not in the manifest" for name in unknown]
    found = tuple(problem for problem in problems if problem)
    return FolderReport(str(folder), len(files), found or tuple(_table_problems(folder, manifest)))


def describe_machine() -> dict[str, Any]:
    """Return what decides the last bits of a value: processor, devices and versions."""
    import jax

    on_cpu = jax.default_backend() == "cpu"
    return {
        "processor": processor(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        # Of CPU devices there may be one for each core; they are one processor all the same.
        "devices": [device.device_kind for device in jax.devices()][: 1 if on_cpu else None],
        "versions": {name: found for name in PACKAGES if (found := installed(name))},
    }


def processor() -> str:
    """Return the processor's name, as Linux tells it, or the machine's type elsewhere.

    XLA's own options of what it may use of a processor make another one of it.
    """
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.is_file() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    options = [word for word in os.environ.get("XLA_FLAGS", "").split() if "xla_cpu" in word]
    return " ".join([next(names, platform.machine()), *sorted(options)])


def write_run(folder: Path, command: str, simulated: bool) -> None:
    """Write the command, see `record_command`, and the sha256 of all files of a folder."""
    record_command(folder, command, simulated)
    seal(folder)


def record_command(folder: Path, command: str, filled: bool) -> None:
    """Write which command filled a folder; where it found all finished, what is there is kept."""
    path = folder / tables.RUN_FILE
    if filled or not path.is_file():
        date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        tables.write_json({"command": command, "date": date, **describe_machine()}, path)


def _files(folder: Path) -> list[Path]:
    """Return the files of ours that are there; a report or a figure of the user's is not."""
    return [path for name in tables.FILES if os.path.lexists(path := folder / name)]


def _check_ours(path: Path) -> None:
    """Refuse what stands in place of a file of ours, such as a link to a pipe.

    Raises:
        ValueError: It is no regular file.
    """
    try:
        check_regular(path.lstat())
    except OSError as error:
        raise ValueError(f"{path} is {error}; put the file itself there") from None


def _file_problem(folder: Path, name: str, digest: str) -> str | None:
    path = folder / name
    if Path(name).name != name:  # a received manifest: nothing outside its folder is read
        return f"the manifest names {shorten(name)}, which is no file of {folder}"
    shown = folder / printable(name)
    try:
        found = received_sha256(path)
    except FileNotFoundError:
        return f"{shown} is missing"
    except (OSError, ValueError) as error:
        return f"{shown} cannot be checked: {printable(str(error))}"
    return None if found == digest else f"{shown}: expected sha256 {shorten(digest)}, found {found}"


def _table_problems(folder: Path, manifest: Mapping[str, Any]) -> list[str]:
    """Hold the episodes against the job that the manifest names: same policies, same episodes."""
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
        wanted = {"ego": set(egos), "partner": set(partners), "episode": set(range(episodes))}
    except (ValueError, OSError, KeyError, TypeError, IndexError) as error:
        return [f"{folder}: {type(error).__name__}: {error}"]
    problems = [
        f"{path} has other {name}s than the manifest"
        for name, values in wanted.items()
        if set(table[name]) != values
    ]
    rows = (1 if paired else len(egos)) * len(partners) * episodes
    doubled = table.height - table.select("ego", "partner", "episode").n_unique()
    if not problems and (doubled or table.height != rows):
        problems = [
            f"{path} has {table.height} rows, {doubled} of them twice; the manifest's job: {rows}"
        ]
    return problems


def installed(name: str) -> str | None:
    """Return the version of a package, None where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
