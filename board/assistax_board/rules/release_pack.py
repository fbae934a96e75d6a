"""A private release: its hidden partners, and all of it as one file, fetched by sha256."""

import io
import secrets
import zipfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_board.problems import Problem

if TYPE_CHECKING:
    from zoo.registry import Registry
    from zoo.schema import PolicyEntry, RegistryFile

MOST_PERSONS = 1000  # of a secret: a panel of 500 is 20 jobs for each robot
REGISTRY_FILE = "registry.json"
MAX_UNPACKED_BYTES = 4 * 1024 * 1024 * 1024
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the same release packs to the same bytes


def pack(folder: Path) -> bytes:
    """Return the registry of a folder and the shards that it names, as an uncompressed zip."""
    from zoo.registry import load_registry

    registry = load_registry(folder / REGISTRY_FILE)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name in (REGISTRY_FILE, *sorted(registry.data.shards)):
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), (folder / name).read_bytes())
    return buffer.getvalue()


def unpack(data: bytes, folder: Path) -> "Registry":
    """Write a packed release to an empty folder and return its registry.

    Raises:
        Problem: It is damaged, or a name in it leads out of the folder.
    """
    from zoo.registry import load_registry

    root = folder.resolve()
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            if sum(info.file_size for info in archive.infolist()) > MAX_UNPACKED_BYTES:
                raise Problem("too_large", "the packed release is too large")
            for info in archive.infolist():
                target = (root / info.filename).resolve()
                if not target.is_relative_to(root) or info.is_dir():
                    raise Problem("invalid", "the packed release has a file of a wrong name")
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(archive.read(info))
    except zipfile.BadZipFile:
        raise Problem("invalid", "the packed release is damaged") from None
    return load_registry(folder / REGISTRY_FILE)


def hidden_partners(registry: "Registry", task: str) -> list["PolicyEntry"]:
    """Return the humans of a private release in the order of their ordinals."""
    from zoo.partners.person_tables import person_glob

    persons = [person_glob(task, release) for release in hidden_persons(registry, task)]
    entries = registry.select(persons) if persons else []
    if not persons or any(entry.task == task for entry in registry.policies):
        entries += registry.select(task=task, role="human")
    return sorted(entries, key=lambda entry: entry.id)


def hidden_persons(registry: "Registry", task: str) -> dict[str, Any]:
    """Return the tables of a task's persons from a secret, by release: program, count, secret."""
    return {
        name: release.persons[task].model_dump()
        for name, release in registry.data.releases.items()
        if task in release.persons and release.persons[task].secret is not None
    }


def secret_persons(leaves: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the statement of secret persons in a season's leaves; usually empty."""
    return next(leaf.get("persons", {}) for leaf in leaves if "seeds" in leaf)


def check_program(season: str, leaves: Sequence[dict[str, Any]]) -> None:
    """Refuse to play a season whose persons acted by another program when it was made.

    Raises:
        Problem: They did.
    """
    from assistax_envs.persons.rows import PROGRAM_VERSION

    made = {table["program"] for table in secret_persons(leaves).values()}
    if made - {PROGRAM_VERSION}:
        raise Problem(
            "conflict",
            f"persons of season {season} act by program {max(made)}, and this version has program "
            f"{PROGRAM_VERSION}; start the version that made it until it is closed",
        )


def add_persons(folder: Path, task: str, count: int) -> Path:
    """Add persons of a new secret to a private release, which is made if there is none.

    Returns:
        Its registry.

    Raises:
        ValueError: The task has no persons, the release has some of it already, or its partners
            play another version of the environment.
    """
    from assistax_base.files import exclusive
    from assistax_envs.preferences import PREFERRED, preferences_of
    from assistax_envs.versions import VERSIONS
    from zoo.partners.person_tables import described
    from zoo.registry import load_registry
    from zoo.saving import save_registry

    if not preferences_of(task):
        raise ValueError(f"task {task!r} has no persons; allowed are {', '.join(PREFERRED)}")
    if not 2 <= count <= MOST_PERSONS:
        raise ValueError(f"count is {count}; allowed are 2 to {MOST_PERSONS}")
    path, version = folder / REGISTRY_FILE, VERSIONS[task]
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    with exclusive(path):
        data = load_registry(path).data if path.exists() else _empty_release()
        name = data.release_of(task)
        release = data.releases[name]
        if task in release.persons:
            raise ValueError(f"{path} has persons of {task}, whose secret stays; name a new folder")
        if release.environments.get(task, version) != version:
            raise ValueError(
                f"partners of {path} play version {release.environments[task]} of {task}, and "
                f"persons version {version}; name a folder of their own"
            )
        added = {
            "environments": {**release.environments, task: version},
            "persons": {**release.persons, task: described(task, secrets.token_hex(32), count)},
        }
        releases = {**data.releases, name: release.model_copy(update=added)}
        save_registry(data.model_copy(update={"releases": releases}), path)
    return path


def _empty_release() -> "RegistryFile":
    from zoo.schema import RegistryFile, Release
    from zoo.verify import installed_settings

    return RegistryFile(
        schema_version=2,
        release="v1",
        releases={"v1": Release(date=f"{datetime.now(UTC):%Y-%m-%d}", environments={})},
        disability_settings=installed_settings(),
        runs={},
        shards={},
        teams={},
    )


def ordinal(index: int) -> str:
    """Return the name of a hidden partner, which tells nothing about the partner."""
    return f"hidden-{index:04d}"


def ordinal_index(name: str) -> int:
    """Return the number in an ordinal: the inverse of `ordinal`."""
    return int(name.removeprefix("hidden-"))
