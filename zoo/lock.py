"""The lock file of a paper: which release, partners, bytes and splits its figures were made with.

It holds, each by sha256, the splits, shards and policies that were pinned, the environment
versions, and a digest of itself. A split that the release does not publish, such as one of the
user's own, stands in it whole, so that others have it too. A registry that has grown since is as
good as the one that the lock was made of; one in which anything pinned differs is refused.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from assistax_base.bounded_reading import parse_json, read_text
from assistax_base.digest import canonical_json, json_sha256, sha256
from assistax_base.errors import LockError, ZooError, listing, shorten
from assistax_base.files import atomic_write
from assistax_base.validated import first_problem
from zoo.history.merkle import leaves
from zoo.namespaces import split_namespace
from zoo.registry import Registry, build_registry
from zoo.schema import Name, PolicyEntry, Sha256, Split, StrictModel, Team
from zoo.splits import check_split, parse_split

LOCK_VERSION = 3  # 2: one digest of all disability settings; 1: without the root and the leaves
MAX_LOCK_BYTES = 16 * 1024 * 1024
# By version, which of the fields that came and went a lock has: the version is not in its sha256.
_FIELDS = {1: {"disability_settings"}, 2: {"root", "disability_settings"}, 3: {"root"}}
_WORDS = {
    "environments": "environment version of",
    "disability_settings": "disability settings",
    "splits": "split",
    "shards": "shard",
    "policies": "policy",
    "leaves": "entry",
}  # what a lock pins, as errors call it


class PinnedSplit(StrictModel):
    """A split by its id and the sha256 of its content."""

    id: str
    sha256: Sha256


class Lock(StrictModel):
    """What a lock file holds."""

    lock_version: Literal[1, 2, 3]
    sha256: Sha256  # of all the rest
    release: str
    root: Sha256 | None = None  # of the release when the lock was made; it may have grown since
    # Of what is pinned, provenance and figures too: see `zoo.history.merkle`.
    leaves: dict[str, Sha256] = Field(default={})
    registry: Sha256  # of the registry.json that it was made of, to tell it from a grown one
    # Of all that the registry had; later locks pin those that are used, among the leaves.
    disability_settings: Sha256 | None = None
    environments: dict[Name, Annotated[int, Field(ge=1)]]
    splits: dict[Name, PinnedSplit]  # by task
    own_splits: tuple[Split, ...] = ()  # those of them that the release does not publish
    shards: dict[str, Sha256]
    policies: Annotated[dict[str, Sha256], Field(min_length=1)]


def make_lock(
    registry: Registry, entries: Sequence[PolicyEntry], splits: Mapping[str, str] | None = None
) -> Lock:
    """Return the lock of policies of one release.

    Args:
        registry: A loaded registry.
        entries: Policies of it.
        splits: Split id to pin for a task; if none is given, the release's default if all its
            partners are pinned.

    Raises:
        LockError: The policies are of several releases, or lack teams of a split.
        SplitError: A split does not exist, or cannot be trusted.
    """
    releases = sorted({entry.release for entry in entries})
    if len(releases) != 1:
        raise LockError(
            "selection",
            "policies of one release",
            f"releases {listing(releases)}",
            "choose one with --release",
        )
    (release,) = releases
    tables = _tables(registry, release)
    pinned = _splits(registry, entries, release, splits or {})
    splits_used = [split.id for split in pinned.values()]
    part = registry.part(split_namespace(release)[0])
    published = {split_namespace(split)[1] for split in (one.id for one in part.splits)}
    own = [split for split in pinned.values() if split_namespace(split.id)[1] not in published]
    content: dict[str, Any] = {
        "release": release,
        "root": registry.root(release),
        "leaves": used_leaves(registry, release, entries, splits_used),
        "registry": sha256(part.path.read_bytes()),
        "environments": {task: tables["environments"][task] for task in _tasks(entries)},
        "splits": {task: {"id": one.id, "sha256": one.sha256} for task, one in pinned.items()},
        **({"own_splits": [split.model_dump(mode="json") for split in own]} if own else {}),
        "shards": {shard: tables["shards"][shard] for shard in sorted({e.shard for e in entries})},
        "policies": {entry.id: entry.sha256 for entry in entries},
    }
    content = {"lock_version": LOCK_VERSION, "sha256": json_sha256(content), **content}
    return Lock.model_validate_json(canonical_json(content))


def write_lock(lock: Lock, path: Path) -> None:
    """Write the lock, atomically."""
    content = lock.model_dump(mode="json", exclude_unset=True)
    atomic_write(path, (json.dumps(content, indent=1) + "\n").encode())


def read_lock(path: Path) -> Lock:
    """Return the lock of a file.

    Raises:
        LockError: It is missing, malformed, of a newer version, or was edited.
    """
    source, remedy = f"lock file {path}", "restore it, or make it again with `assistax-zoo lock`"
    text = read_text(path, MAX_LOCK_BYTES, LockError, "lock file", remedy)
    try:
        version = parse_json(text)["lock_version"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise LockError(
            source, "a lock file", f"{type(error).__name__}: {shorten(str(error))}", remedy
        ) from None
    if version not in _FIELDS:
        raise LockError(
            source,
            f"lock version {LOCK_VERSION} or older",
            f"version {shorten(version)}",
            "upgrade assistax-zoo",
        )
    try:
        lock = Lock.model_validate_json(text)
    except ValidationError as error:
        raise LockError(source, "a lock file", first_problem(error), remedy) from None
    fields = {name for name in ("root", "disability_settings") if getattr(lock, name) is not None}
    if fields != _FIELDS[lock.lock_version]:
        raise LockError(source, f"content of version {version}", "another's: it was edited", remedy)
    dumped = lock.model_dump(mode="json", exclude={"lock_version", "sha256"}, exclude_unset=True)
    found = json_sha256(dumped)
    if found != lock.sha256:
        raise LockError(
            source, f"content of sha256 {lock.sha256}", f"sha256 {found}: it was edited", remedy
        )
    return lock


def apply_lock(registry: Registry, lock: Lock, *, task: str, split: str | None = None) -> Registry:
    """Return the registry narrowed down to what the lock pins, so that nothing else can be loaded.

    Args:
        registry: The registry of this machine.
        lock: What is allowed.
        task: Task that is about to be evaluated.
        split: `--split` of the user, if any: only the pinned one is allowed, or a side of it.

    Raises:
        LockError: The registry differs in something pinned, or another task or split is asked for.
    """
    _check(registry, lock)
    registry = _with_own_splits(registry, lock)
    if task not in lock.environments:
        raise LockError(
            f"task {shorten(task)}",
            f"a task of the lock ({listing(lock.environments)})",
            "another",
            "make a lock of it",
        )
    _check_split(registry, lock, task, split)
    release = registry.data.releases[lock.release]
    defaults = {task: pinned.id for task, pinned in lock.splits.items()}
    keep = {policy.rpartition("/")[0] for policy in lock.policies}
    data = registry.data.model_copy(
        update={
            "release": lock.release,
            "releases": {lock.release: release.model_copy(update={"splits": defaults})},
            "shards": {shard: registry.data.shards[shard] for shard in lock.shards},
            "teams": {
                name: _narrowed(name, team, lock)
                for name, team in registry.data.teams.items()
                if name in keep
            },
            "egos": {name: ego for name, ego in registry.data.egos.items() if name in keep},
            "splits": tuple(one for one in registry.splits if one.id in defaults.values()),
        }
    )
    return dataclasses.replace(
        build_registry(data, registry.path),
        lock=lock.sha256,
        parts=registry.parts or {"": registry},  # a root is of all that the release holds
    )


def locked_entries(registry: Registry, lock: Lock) -> list[PolicyEntry]:
    """Return the policies that the lock pins.

    Raises:
        LockError: The registry differs in something pinned.
    """
    _check(registry, lock)
    return [entry for entry in registry.policies if entry.id in lock.policies]


def _narrowed(name: str, team: Team, lock: Lock) -> Team:
    rows = {role: row for role, row in team.policies.items() if f"{name}/{role}" in lock.policies}
    return team.model_copy(update={"policies": rows})


def _check(registry: Registry, lock: Lock) -> None:
    """Hold everything that the lock pins against the registry."""
    if lock.release not in registry.data.releases:
        found = f"releases {listing(registry.data.releases)}"
        raise _differs(registry, f"release {lock.release}", found)
    for split in lock.own_splits:
        check_split(split)
    own = {split.id for split in lock.own_splits}
    pinned = {
        **lock.model_dump(),
        "disability_settings": {"": lock.disability_settings} if lock.lock_version == 1 else {},
        "splits": {split.id: split.sha256 for split in lock.splits.values() if split.id not in own},
    }
    for table, found in _tables(registry, lock.release).items():
        for name, value in pinned[table].items():
            if found.get(name) != value:
                what = f"{_WORDS[table]} {name} {value}".replace("  ", " ")
                raise _differs(registry, what, str(found.get(name, "none")))


def _tables(registry: Registry, release: str) -> dict[str, Mapping[str, Any]]:
    """Return all that a lock of a release can pin, by the lock's fields."""
    namespace, name = split_namespace(release)
    part = registry.part(namespace).data  # whatever was added to it
    settings = {key: setting.model_dump() for key, setting in part.disability_settings.items()}
    return {
        "environments": registry.data.releases[release].environments,
        "disability_settings": {"": json_sha256(settings)},
        "splits": {split.id: split.sha256 for split in registry.splits},
        "shards": {path: shard.sha256 for path, shard in registry.data.shards.items()},
        "policies": {entry.id: entry.sha256 for entry in registry.policies},
        "leaves": leaves(part, name),
    }


def _with_own_splits(registry: Registry, lock: Lock) -> Registry:
    """Return the registry with the splits that stand in the lock whole, beside its own."""
    known = {split.id for split in registry.splits}
    splits = [split for split in lock.own_splits if split.id not in known]
    data = registry.data.model_copy(update={"splits": (*registry.splits, *splits)})
    return dataclasses.replace(registry, data=data, parts=registry.parts or {"": registry})


def _differs(registry: Registry, expected: str, found: str) -> LockError:
    advice = "fetch what was locked (`assistax-zoo fetch --lock FILE --from REMOTE`), or lock anew"
    return LockError(f"registry {registry.path}", f"{expected}, as locked", found, advice)


def _check_split(registry: Registry, lock: Lock, task: str, split: str | None) -> None:
    name, _ = parse_split(split, registry.parts)
    if name is None:
        return
    pinned = lock.splits.get(task)
    try:
        asked = registry.split(task, name).id
    except ZooError:
        asked = name
    if pinned is None or asked != pinned.id:
        expected = f"the locked one ({pinned.id if pinned else 'none'})"
        advice = "leave --split out, or name only a side: test, train or both"
        raise LockError(f"split {shorten(name)}", expected, asked, advice)


def _splits(
    registry: Registry, entries: Sequence[PolicyEntry], release: str, chosen: Mapping[str, str]
) -> dict[str, Split]:
    """Return the splits to pin: those chosen, and the defaults of which every partner is pinned."""
    if foreign := sorted(set(chosen) - set(_tasks(entries))):
        found = f"splits of {listing(foreign)}"
        advice = "name splits of these tasks, as TASK/NAME"
        raise LockError("lock", f"splits of {listing(_tasks(entries))}", found, advice)
    teams = {entry.team for entry in entries if entry.role == "human"}
    pinned = {}
    for task in _tasks(entries):
        if task not in chosen and task not in registry.data.releases[release].splits:
            continue  # a release of one half has no default split
        split = registry.split(task, chosen.get(task), release=release)
        absent = [team for team in (*split.train, *split.test) if team not in teams]
        if absent and task in chosen:
            found, advice = f"{listing(absent)} left out", "lock all partners of the task"
            raise LockError(
                f"lock of {split.id}", "every partner of the split in the selection", found, advice
            )
        if not absent:
            pinned[task] = split
    return pinned


def used_leaves(
    registry: Registry, release: str, entries: Sequence[PolicyEntry], splits: Iterable[str]
) -> dict[str, str]:
    """Return the leaves of a release's tree that some of its policies and splits are made of."""
    namespace, name = split_namespace(release)
    teams = {split_namespace(entry.team)[1] for entry in entries}
    runs = {split_namespace(entry.run)[1] for entry in entries}
    wanted = {f"{kind} {team}" for team in teams for kind in ("team", "ego")}
    wanted |= {f"run {run}" for run in runs}
    wanted |= {f"setting {entry.disability}" for entry in entries}
    wanted |= {f"split {split_namespace(split)[1]}" for split in splits}
    found = leaves(registry.part(namespace).data, name)
    return {leaf: digest for leaf, digest in found.items() if leaf in wanted}


def _tasks(entries: Sequence[PolicyEntry]) -> list[str]:
    return sorted({entry.task for entry in entries})
