"""Where a folder's figures come from: its manifest, which names every byte that they depend on.

`manifest.json` holds the job's identity (policies and partners by the hash of their parameters,
environment, engine, versions), its digest, how it was made, and the sha256 of every file that was
drawn from it. Its sources are named alike: the policies and the registry's entries about them, own
robots' files, the kept episodes of reference egos. It has a hash of its own, so that no bit of it
can change unseen either. `evaluation.record.verification` holds all that against what is here.
"""

import datetime
import functools
import hashlib
import importlib.metadata
import os
import platform
import stat
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_base.digest import json_sha256
from evaluation.record import tables
from zoo.locking import used_leaves
from zoo.registry import Registry
from zoo.schema import PolicyEntry

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


def check_ours(path: Path) -> None:
    """Refuse what stands in place of a file of ours, such as a link to a pipe.

    Raises:
        ValueError: It is no regular file.
    """
    try:
        check_regular(path.lstat())
    except OSError as error:
        raise ValueError(f"{path} is {error}; put the file itself there") from None


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
    check_ours(path)
    manifest = tables.read_json(path)
    bare = {name: value for name, value in manifest.items() if name != "sha256"}
    if manifest.get("sha256") != identity_digest(bare):
        raise ValueError(
            f"{path} was changed after it was written: its sha256 is another; take the folder from "
            "where it was made, or choose another folder"
        )
    return manifest


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
    files = {path.name: file_sha256(path) for path in our_files(folder)}
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


def our_files(folder: Path) -> list[Path]:
    """Return the files of ours that are there; a report or a figure of the user's is not."""
    return [path for name in tables.FILES if os.path.lexists(path := folder / name)]


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
        "files": {str(path.resolve()): file_sha256(path) for path in files},
    }


def describe_machine() -> dict[str, Any]:
    """Return processor, devices, versions and settings: they decide the last bits of a value."""
    import jax

    from assistax_envs.own_settings import found_settings

    on_cpu = jax.default_backend() == "cpu"
    return {
        "processor": processor(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        # Of CPU devices there may be one for each core; they are one processor all the same.
        "devices": [device.device_kind for device in jax.devices()][: 1 if on_cpu else None],
        "versions": {name: number for name in PACKAGES if (number := installed(name))},
        "settings": found_settings(),
    }


def processor() -> str:
    """Return the processor's name, as Linux has it, or the machine's type elsewhere.

    XLA's own options of what it may use of a processor make another one of it.
    """
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.is_file() else []
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


def installed(name: str) -> str | None:
    """Return the version of a package, None where it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
