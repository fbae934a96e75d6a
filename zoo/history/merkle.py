"""Root of a release: the digest of a Merkle tree over its entries.

A leaf is the sha256 of one entry: a team with its self-play, an ego, a shard, a run's provenance, a
split, a disability setting that is used, a task's persons, and the release's own record. A tree's
node is the sha256 of its children's; an odd node goes up unchanged. Entries are written without
the fields that are at their defaults, so that a later schema gives the same leaves. A release grows
by leaves. Only the leaf of its own record, which names its default splits, may change.
"""

from collections.abc import Mapping
from typing import Any

from assistax_base.digest import leaf_sha256, merkle_root
from assistax_base.errors import IntegrityError
from zoo.ids import EGO, parse_team
from zoo.schema import RegistryFile

RECORD = "release"  # kind of the leaf that may change


def leaves(data: RegistryFile, release: str) -> dict[str, str]:
    """Return the sha256 of each entry of a release by kind and name, as "team scratch/..."."""
    members = {
        name: (parse_team(name).disability, entry)
        for name, entry in data.members.items()
        if parse_team(name).release == release
    }
    shards = {row.shard for _, entry in members.values() for row in entry.policies.values()}
    used = {disability for disability, _ in members.values()} - {EGO}
    record = data.releases[release]
    apart = {"root": None, "signature": None, "persons": {}}
    entries: dict[str, Any] = {f"{RECORD} {release}": record.model_copy(update=apart)}
    entries |= {persons_leaf(task): table for task, table in record.persons.items()}
    entries |= {
        f"{'ego' if disability == EGO else 'team'} {name}": entry
        for name, (disability, entry) in members.items()
    }
    entries |= {f"run {name}": data.runs[name] for name in {e.run for _, e in members.values()}}
    entries |= {f"shard {path}": data.shards[path] for path in shards}
    entries |= {f"setting {name}": data.disability_settings[name] for name in used}
    entries |= {f"split {split.id}": split for split in data.splits if split.release == release}
    return {name: _leaf(name, entry) for name, entry in sorted(entries.items())}


def persons_leaf(task: str) -> str:
    """Return the name of the leaf of a task's table of persons."""
    return f"persons {task}"


def release_root(data: RegistryFile, release: str) -> str:
    """Return the root of a release's present entries, which the recorded root may differ from."""
    return merkle_root(leaves(data, release).values())


def with_roots(data: RegistryFile) -> RegistryFile:
    """Return the registry with the root of every release; signatures of other roots are removed."""
    releases = {}
    for name, release in data.releases.items():
        root = release_root(data, name)
        signature = release.signature if release.root == root else None
        releases[name] = release.model_copy(update={"root": root, "signature": signature})
    return data.model_copy(update={"releases": releases})


def root_problems(data: RegistryFile) -> list[str]:
    """Return a message for each release whose entries differ from its recorded root."""
    return [
        f"release {name}: expected root {release.root}, found {found}; an entry, a split, a "
        "setting or the provenance of a run was changed, added or removed"
        for name, release in data.releases.items()
        if (found := release_root(data, name)) != release.root
    ]


def check_roots(data: RegistryFile, source: str) -> None:
    """Check every release against its recorded root; `source` names the registry in the error.

    Raises:
        IntegrityError: An entry was changed, added or removed.
    """
    if problems := root_problems(data):
        raise IntegrityError(
            f"registry {source}",
            "releases with the roots that it records",
            problems[0],
            "restore the registry; `assistax-zoo verify` lists all that is wrong",
            "nothing was read",
        )


def lost_leaves(old: RegistryFile, new: RegistryFile) -> list[str]:
    """Return the names of the old registry's entries that the new one lacks or has changed."""
    lost = []
    for release, record in old.releases.items():
        versions = new.releases[release].environments if release in new.releases else {}
        lost += [
            f"version {version} of {task} in {release}"
            for task, version in record.environments.items()
            if versions.get(task) != version
        ]
        now: Mapping[str, str] = leaves(new, release) if release in new.releases else {}
        lost += [
            name
            for name, digest in leaves(old, release).items()
            if not name.startswith(RECORD) and now.get(name) != digest
        ]
    return lost


def _leaf(name: str, entry: Any) -> str:
    return leaf_sha256([name, entry.model_dump(mode="json", exclude_defaults=True)])
