"""The lock file of a paper: which release, partners, bytes and splits its figures were made with.

It holds, each by sha256, the splits, shards and policies that were pinned, the environment
versions, and a digest of itself. A registry that has grown since is as good as the one that the
lock was made of; one in which anything pinned differs is refused.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from population.files import atomic_write, sha256
from zoo.errors import LockError, ZooError, listing, shorten
from zoo.namespaces import split_namespace
from zoo.registry import Registry, build_registry
from zoo.roots import leaves
from zoo.schema import Name, PolicyEntry, Sha256, Team, first_problem
from zoo.untrusted import parse_json, read_text

LOCK_FILE = "assistax-zoo.lock"
LOCK_VERSION = 2  # 1: without the root and the leaves
MAX_LOCK_BYTES = 16 * 1024 * 1024


class PinnedSplit(BaseModel):
    """A split by its id and the sha256 of its content."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
    id: str
    sha256: Sha256


class Lock(BaseModel):
    """What a lock file holds."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
    lock_version: Literal[1, 2]
    sha256: Sha256  # of all the rest
    release: str
    root: Sha256 | None = None  # of the release when the lock was made; it may have grown since
    leaves: dict[str, Sha256] = {}  # of what is pinned, provenance and figures too: see `zoo.roots`
    registry: Sha256  # of the registry.json that it was made of, to tell it from a grown one
    disability_settings: Sha256
    environments: dict[Name, Annotated[int, Field(ge=1)]]
    splits: dict[Name, PinnedSplit]  # by task
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
    pinned = _splits(registry, entries, release, splits or {})
    content: dict[str, Any] = {
        "release": release,
        "root": registry.root(release),
        "leaves": _leaves(registry, release, entries, pinned),
        "registry": sha256(registry.path.read_bytes()),
        "disability_settings": _settings_digest(registry, release),
        "environments": {
            task: registry.data.releases[release].environments[task] for task in _tasks(entries)
        },
        "splits": pinned,
        "shards": {
            shard: registry.data.shards[shard].sha256
            for shard in sorted({entry.shard for entry in entries})
        },
        "policies": {entry.id: entry.sha256 for entry in entries},
    }
    return Lock.model_validate(
        {"lock_version": LOCK_VERSION, "sha256": _digest(content), **content}
    )


def write_lock(lock: Lock, path: Path) -> None:
    """Write the lock, atomically."""
    atomic_write(
        path,
        (json.dumps(lock.model_dump(mode="json", exclude_unset=True), indent=1) + "\n").encode(),
    )


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
    if version not in (1, LOCK_VERSION):
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
    if (lock.lock_version == LOCK_VERSION) != (lock.root is not None):  # it is not in the sha256
        raise LockError(source, f"content of version {version}", "another's: it was edited", remedy)
    dumped = lock.model_dump(mode="json", exclude={"lock_version", "sha256"}, exclude_unset=True)
    found = _digest(dumped)
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
        _differs(registry, f"release {lock.release}", f"releases {listing(registry.data.releases)}")
    known = {entry.id: entry.sha256 for entry in registry.policies}
    shards = {path: shard.sha256 for path, shard in registry.data.shards.items()}
    splits = {split.id: split.sha256 for split in registry.splits}
    _compare(
        registry,
        "environment version of",
        lock.environments,
        registry.data.releases[lock.release].environments,
    )
    _compare(
        registry,
        "disability settings",
        {"": lock.disability_settings},
        {"": _settings_digest(registry, lock.release)},
    )
    _compare(
        registry, "split", {pinned.id: pinned.sha256 for pinned in lock.splits.values()}, splits
    )
    _compare(registry, "shard", lock.shards, shards)
    _compare(registry, "policy", lock.policies, known)
    if lock.leaves:
        namespace, release = split_namespace(lock.release)
        _compare(registry, "entry", lock.leaves, leaves(registry.part(namespace).data, release))


def _compare(
    registry: Registry, what: str, pinned: Mapping[str, Any], found: Mapping[str, Any]
) -> None:
    for name, value in pinned.items():
        if found.get(name) != value:
            _differs(
                registry, f"{what} {name} {value}".replace("  ", " "), str(found.get(name, "none"))
            )


def _differs(registry: Registry, expected: str, found: str) -> NoReturn:
    advice = "fetch what was locked (`assistax-zoo fetch --lock FILE --from REMOTE`), or lock anew"
    raise LockError(f"registry {registry.path}", f"{expected}, as locked", found, advice)


def _check_split(registry: Registry, lock: Lock, task: str, split: str | None) -> None:
    name = (split or "").partition(":")[0]
    if not split or name in ("test", "train", "both"):
        return
    pinned = lock.splits.get(task)
    try:
        asked = registry.split(task, name).id
    except ZooError:
        asked = name
    if pinned is None or asked != pinned.id:
        expected = f"the locked one ({pinned.id if pinned else 'none'})"
        raise LockError(
            f"split {shorten(name)}",
            expected,
            asked,
            "leave --split out, or name only a side: test, train or both",
        )


def _splits(
    registry: Registry, entries: Sequence[PolicyEntry], release: str, chosen: Mapping[str, str]
) -> dict[str, dict[str, str]]:
    """Return the splits to pin: those chosen, and the defaults of which every partner is pinned."""
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
            pinned[task] = {"id": split.id, "sha256": split.sha256}
    return pinned


def _leaves(
    registry: Registry,
    release: str,
    entries: Sequence[PolicyEntry],
    splits: Mapping[str, Mapping[str, str]],
) -> dict[str, str]:
    """Return the leaves of the release's tree that the selection is made of."""
    namespace, name = split_namespace(release)
    teams = {split_namespace(entry.team)[1] for entry in entries}
    runs = {split_namespace(entry.run)[1] for entry in entries}
    wanted = {f"{kind} {team}" for team in teams for kind in ("team", "ego")}
    wanted |= {f"run {run}" for run in runs}
    wanted |= {f"split {split_namespace(split['id'])[1]}" for split in splits.values()}
    found = leaves(registry.part(namespace).data, name)
    return {leaf: digest for leaf, digest in found.items() if leaf in wanted}


def _tasks(entries: Sequence[PolicyEntry]) -> list[str]:
    return sorted({entry.task for entry in entries})


def _settings_digest(registry: Registry, release: str) -> str:
    """Return the sha256 of the settings of the zoo that a release is of, whatever was added."""
    settings = registry.part(split_namespace(release)[0]).data.disability_settings
    return _digest({name: setting.model_dump() for name, setting in settings.items()})


def _digest(content: Mapping[str, Any]) -> str:
    return sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode())
