"""Make a lock, which pins a selection of policies and their splits. See `zoo.lock`."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from assistax_base.digest import sha256
from assistax_base.errors import LockError, listing
from assistax_base.files import atomic_write
from zoo.history.merkle import leaves
from zoo.lock import LOCK_VERSION, Lock, PinnedSplit
from zoo.namespaces import plain_name
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split


def make_lock(
    registry: Registry, entries: Sequence[PolicyEntry], splits: Mapping[str, str] | None = None
) -> Lock:
    """Return the lock of policies of one release.

    Args:
        registry: A loaded registry.
        entries: Policies of it.
        splits: Split id to pin for a task; if none is given, the release's default if all its
            partners are pinned. A split of persons is pinned without its teams if one is not.

    Raises:
        LockError: The policies are of several releases, or lack teams of a split.
        SplitError: A split does not exist, or cannot be trusted.
    """
    if made := [entry.id for entry in entries if not entry.shard]:
        source = registry.source_of(made[0])
        found = f"{len(made)} {source.word}, {source.pinned}"
        advice = "lock the task's robots, which pins its persons and their split too"
        raise LockError("selection", "policies that have bytes", found, advice)
    releases = sorted({entry.release for entry in entries})
    if len(releases) != 1:
        found = f"releases {listing(releases)}"
        raise LockError("selection", "policies of one release", found, "choose one release")
    (release,) = releases
    part, _ = registry.part_of(release)
    pinned = _splits(registry, entries, release, splits or {})
    published = {plain_name(split.id) for split in part.splits}
    own = tuple(
        split
        for split in pinned.values()
        if plain_name(split.id) not in published
        and registry.source_of_split(split) is registry.teams
    )
    versions = registry.data.releases[release].environments
    lock = Lock(
        lock_version=LOCK_VERSION,
        sha256="0" * 64,
        release=release,
        root=registry.root(release),
        leaves=used_leaves(registry, release, entries, [split.id for split in pinned.values()]),
        registry=sha256(part.path.read_bytes()),
        environments={task: versions[task] for task in _tasks(entries)},
        splits={
            task: PinnedSplit(id=split.id, sha256=split.sha256) for task, split in pinned.items()
        },
        own_splits=own,
        policies={entry.id: entry.sha256 for entry in entries},
    )
    return lock.model_copy(update={"sha256": lock.content_sha256})


def write_lock(lock: Lock, path: Path) -> None:
    """Write the lock, atomically."""
    content = lock.model_dump(mode="json", exclude_unset=True)
    atomic_write(path, (json.dumps(content, indent=1) + "\n").encode())


def used_leaves(
    registry: Registry, release: str, entries: Sequence[PolicyEntry], splits: Iterable[str]
) -> dict[str, str]:
    """Return the leaves of a release's tree that some of its policies and splits are made of."""
    ids = [plain_name(split) for split in splits]
    names = {f"split {split}" for split in ids}
    for split in ids:
        kinds = (source for source in registry.sources[1:] if source.names_split(split))
        names |= next(kinds, registry.teams).split_leaves(split.partition("/")[0])
    for entry in entries:
        team = plain_name(entry.team)
        names |= {f"team {team}", f"ego {team}", f"setting {entry.disability}"}
        names |= registry.source_of(entry.id).leaves(entry)
        names |= {f"run {plain_name(entry.run)}", f"shard {plain_name(entry.shard)}"}
    part, name = registry.part_of(release)
    if name not in part.data.releases:  # of partners that belong to no release
        return {}
    return {leaf: digest for leaf, digest in leaves(part.data, name).items() if leaf in names}


def _splits(
    registry: Registry, entries: Sequence[PolicyEntry], release: str, chosen: Mapping[str, str]
) -> dict[str, Split]:
    """Return the splits to pin: those chosen, and the defaults of which every partner is pinned."""
    tasks = _tasks(entries)
    if foreign := sorted(set(chosen) - set(tasks)):
        advice = "name splits of these tasks, as TASK/NAME"
        expected = f"splits of {listing(tasks)}"
        raise LockError("lock", expected, f"splits of {listing(foreign)}", advice)
    teams = {entry.team for entry in entries if entry.role == "human"}
    pinned = {}
    for task in tasks:
        published = registry.data.releases[release]
        if task not in {*chosen, *published.splits, *published.persons}:
            continue  # a release of one half has no default split
        split = registry.split(task, chosen.get(task), release=release)
        source = registry.source_of_split(split)
        absent = [team for team in source.teams_of(split) if team not in teams]
        if absent and task in chosen:
            expected = "every partner of the split in the selection"
            found, advice = f"{listing(absent)} left out", "lock all partners of the task"
            raise LockError(f"lock of {split.id}", expected, found, advice)
        if absent and source.alone(split) != split:
            split, absent = source.alone(split), []
        if not absent:
            pinned[task] = split
    return pinned


def _tasks(entries: Sequence[PolicyEntry]) -> list[str]:
    return sorted({entry.task for entry in entries})
