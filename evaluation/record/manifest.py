"""The manifest of a folder, with hashes of everything that its figures depend on.

`manifest.json` holds the job's identity (`evaluation.play.jobs.Job.identity`: policies and partners
by the hash of their parameters, environment, engine, versions), the identity's digest, the machine,
and the sha256 of every result file. It also has hashes of the sources: policies and their entries
in the registry, own robots' files, cached episodes of reference egos. Its own hash shows if it was
changed. `evaluation.record.verification` checks all of these.
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
LARGEST = 1 << 30  # bytes of a hashed file: a received manifest may name any file
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
    """Check that a status is of a regular file of at most `LARGEST` bytes.

    Raises:
        OSError: It is a link, a pipe, a device, a file of the kernel, or too large.
    """
    if not stat.S_ISREG(status.st_mode) or status.st_dev in _kernel_devices():
        raise OSError("no regular file")
    if status.st_size > LARGEST:
        raise OSError(f"larger than {LARGEST} bytes")


@functools.cache
def _kernel_devices() -> set[int]:
    """Return the device numbers of /proc and /sys, whose files the kernel makes when read."""
    places = [place for place in ("/proc", "/sys") if os.path.ismount(place)]
    return {os.stat(place).st_dev for place in places}


def received_sha256(path: Path) -> str:
    """Return the sha256 of an untrusted file, or of a file with an untrusted name.

    At most as many bytes as its size are read.

    Raises:
        OSError: It is no regular file (a link, a pipe, a device), or larger than `LARGEST`.
    """
    # Checked before it is opened, because opening a device may have effects.
    check_regular(path.lstat())
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
    """Check that a result file is a regular file, not for example a link to a pipe.

    Raises:
        ValueError: It is no regular file.
    """
    try:
        check_regular(path.lstat())
    except OSError as error:
        raise ValueError(f"{path} is {error}; put the file itself there") from None


def identity_digest(identity: Any) -> str:
    """Return the sha256 of a JSON-ready identity, such as a job's."""
    return json_sha256(identity, spaced=True)


def write_manifest(folder: Path, content: Mapping[str, Any]) -> None:
    """Write a folder's manifest, with the hash of its content added."""
    bare = {name: value for name, value in tables.to_json(content).items() if name != "sha256"}
    tables.write_json({**bare, "sha256": identity_digest(bare)}, folder / MANIFEST_FILE)


def read_manifest(folder: Path) -> dict[str, Any] | None:
    """Return a folder's manifest, or None if there is none.

    Raises:
        ValueError: The manifest was changed after it was written.
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
    """Return whether a folder's manifest is undamaged or missing."""
    try:
        read_manifest(folder)
    except ValueError:
        return False
    return True


def seal(folder: Path, **context: Any) -> None:
    """Write the sha256 of every result file of a folder into its manifest.

    Args:
        folder: A finished folder.
        context: More fields of the manifest, such as the machine or the registry's root.
    """
    files = {path.name: file_sha256(path) for path in our_files(folder)}
    write_manifest(folder, {**(read_manifest(folder) or {}), **context, "files": files})


def table_hashes(folder: Path) -> dict[str, str]:
    """Return the hashes of a folder's tables by file name, equal for equal jobs and options.

    Files that depend on the run are omitted: the summary, the command, and the matrix's picture.
    """
    files = (read_manifest(folder) or {}).get("files", {})
    run = (tables.SUMMARY_FILE, tables.RUN_FILE, tables.MATRIX_FIGURE)
    return {name: digest for name, digest in files.items() if name not in run}


def has_whole(folder: Path, name: str) -> bool:
    """Return whether a folder's file exists with the hash in the manifest."""
    path = folder / name
    recorded = (read_manifest(folder) or {}).get("files", {}).get(name)
    return path.is_file() and recorded == file_sha256(path)


def our_files(folder: Path) -> list[Path]:
    """Return the paths of existing result files, without reports and figures of the user."""
    return [path for name in tables.FILES if os.path.lexists(path := folder / name)]


def describe_sources(
    registry: Registry, entries: Sequence[PolicyEntry], split: str | None, files: Iterable[Path]
) -> dict[str, Any]:
    """Return the manifest's field `sources`: registry, split, releases and files with hashes.

    Args:
        registry: The registry of the policies.
        entries: All of its policies that were played.
        split: The id of the split, if sides are distinguished.
        files: Files of own robots and of other folders.
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
    """Return processor, devices, versions and settings, on which the last bits of values depend."""
    import jax

    from assistax_envs.own_settings import found_settings

    on_cpu = jax.default_backend() == "cpu"
    return {
        "processor": processor(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        # There may be one CPU device for each core of the same processor.
        "devices": [device.device_kind for device in jax.devices()][: 1 if on_cpu else None],
        "versions": {name: number for name in PACKAGES if (number := installed(name))},
        "settings": found_settings(),
    }


def processor() -> str:
    """Return the processor's name of Linux, or the machine's type on other systems.

    XLA options for the CPU are appended, because they change the last bits of values.
    """
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.is_file() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    options = [word for word in os.environ.get("XLA_FLAGS", "").split() if "xla_cpu" in word]
    return " ".join([next(names, platform.machine()), *sorted(options)])


def write_run(folder: Path, command: str, simulated: bool) -> None:
    """Write a folder's command (see `record_command`) and seal the folder."""
    record_command(folder, command, simulated)
    seal(folder)


def record_command(folder: Path, command: str, filled: bool) -> None:
    """Write the command that filled a folder; keep an existing record if it simulated nothing."""
    path = folder / tables.RUN_FILE
    if filled or not path.is_file():
        date = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        tables.write_json({"command": command, "date": date, **describe_machine()}, path)


def installed(name: str) -> str | None:
    """Return the version of a package, or None if it is not installed."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
