"""A private release: its hidden partners, and all of it as one file, fetched by sha256."""

import io
import secrets
import zipfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_base.extensions import files_sha256
from assistax_board.problems import Problem

if TYPE_CHECKING:
    from zoo.registry import Registry
    from zoo.schema import OwnFamily, PolicyEntry, RegistryFile

OWN_SHARE = 3  # of so many persons of a draw, one is of the organiser's own family
MOST_PERSONS = 1000  # of a secret: a panel of 500 is 20 jobs for each robot
REGISTRY_FILE = "registry.json"
FAMILY = "families"  # folder of the packages' files in a packed release
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
        for own in own_families(registry):
            for name, data in _program(own).items():
                archive.writestr(zipfile.ZipInfo(f"{FAMILY}/{own.name}/{name}", _EPOCH), data)
    return buffer.getvalue()


def own_families(registry: "Registry") -> list["OwnFamily"]:
    """Return the families of packages in the tables of persons of a release."""
    tables = [t for release in registry.data.releases.values() for t in release.persons.values()]
    return [table.own for table in tables if table.own is not None]


def _program(own: "OwnFamily") -> dict[str, bytes]:
    """Return the files of a family's package, which are those that the release names.

    Raises:
        Problem: The package is not installed, or has other files.
    """
    from assistax_envs.persons.rows import check_files

    try:
        return check_files(own.name, own.sha256).files()
    except ValueError as error:
        raise Problem("conflict", str(error)) from None


def revealed_program(own: "OwnFamily", folder: Path) -> str:
    """Return the sha256 of a family's files in an unpacked release; they are read, never run."""
    root = folder / FAMILY / own.name
    paths = sorted(path for path in root.rglob("*") if path.is_file())
    return files_sha256({p.relative_to(root).as_posix(): p.read_bytes() for p in paths})


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
        name: release.persons[task].model_dump(exclude_none=True)
        for name, release in registry.data.releases.items()
        if task in release.persons and release.persons[task].secret is not None
    }


def secret_persons(leaves: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the statement of secret persons in a season's leaves; usually empty."""
    return next(leaf.get("persons", {}) for leaf in leaves if "seeds" in leaf)


def check_program(season: str, leaves: Sequence[dict[str, Any]]) -> None:
    """Refuse to play a season whose persons acted by another program when it was made.

    So too one with a family of a package that is not installed here, or in other files.

    Raises:
        Problem: They did.
    """
    from assistax_envs.persons.rows import PROGRAM_VERSION, check_files

    made = {table["program"] for table in secret_persons(leaves).values()}
    if made - {PROGRAM_VERSION}:
        raise Problem(
            "conflict",
            f"persons of season {season} act by program {max(made)}, and this version has program "
            f"{PROGRAM_VERSION}; start the version that made it until it is closed",
        )
    for own in [table["own"] for table in secret_persons(leaves).values() if "own" in table]:
        try:
            check_files(own["name"], own["sha256"])
        except ValueError as error:
            raise Problem("conflict", f"season {season}: {error}, until it is closed") from None


def add_persons(folder: Path, task: str, count: int, family: str | None = None) -> Path:
    """Add persons of a new secret to a private release, which is made if there is none.

    Args:
        folder: Of the private release.
        task: Gentle task.
        count: Number of persons.
        family: Name of an installed package's family, of which the last third is; no one's if not
            given. The release names the sha256 of its files.

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
    least = 2 if family is None else OWN_SHARE
    if not least <= count <= MOST_PERSONS:
        raise ValueError(f"count is {count}; allowed are {least} to {MOST_PERSONS}")
    own = None if family is None else _own_family(task, family, count // OWN_SHARE)
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
        table = described(task, secrets.token_hex(32), count).model_copy(update={"own": own})
        added = {
            "environments": {**release.environments, task: version},
            "persons": {**release.persons, task: table},
        }
        releases = {**data.releases, name: release.model_copy(update=added)}
        save_registry(data.model_copy(update={"releases": releases}), path)
    return path


def _own_family(task: str, name: str, count: int) -> "OwnFamily":
    """Return the record of an installed family, once two of its persons have acted.

    Raises:
        ValueError: There is none of this name, or it cannot act.
    """
    from assistax_envs.persons.player import try_family
    from assistax_envs.persons.rows import installed_family
    from zoo.schema import OwnFamily

    extension = installed_family(name)
    try_family(task, name)
    about = {"package": extension.package, "version": extension.version, "count": count}
    return OwnFamily(name=name, sha256=files_sha256(extension.files()), **about)


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
