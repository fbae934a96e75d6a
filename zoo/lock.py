"""The lock file of a paper: which release, partners, bytes and splits its figures were made with.

It names a release and its root, which policies and splits were used, and by their names the leaves
of the release's tree that these are made of, with a digest of itself. Persons have no bytes: their
table and their split are pinned. A split that the release does
not publish, such as one of the user's own, stands in it whole, so that others have it too. A
registry that has grown since is as good as the one that the lock was made of; one in which anything
pinned differs is refused.
"""

import contextlib
import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from assistax_base.bounded_reading import parse_json, read_text
from assistax_base.digest import json_sha256
from assistax_base.errors import LockError, ZooError, listing, shorten
from assistax_base.validated import first_problem
from zoo.history.merkle import leaves, persons_leaf
from zoo.partners.sides import parse_split
from zoo.registry import Registry, build_registry
from zoo.schema import Name, PolicyEntry, Sha256, Split, StrictModel, Team
from zoo.splits import check_split

LOCK_VERSION = 3
MAX_LOCK_BYTES = 16 * 1024 * 1024
_REMEDY = "restore it, or make it again with `assistax-zoo lock`"


class PinnedSplit(StrictModel):
    """A split by its id and the sha256 of its content."""

    id: str
    sha256: Sha256


class Lock(StrictModel):
    """Content of a lock file."""

    lock_version: Literal[3]
    sha256: Sha256  # of all the rest
    release: str
    root: Sha256  # of the release when the lock was made; it may have grown since
    leaves: dict[str, Sha256]  # by name, see `zoo.history.merkle`
    registry: Sha256  # of the registry.json that it was made of, to tell it from a grown one
    environments: dict[Name, Annotated[int, Field(ge=1)]]
    splits: dict[Name, PinnedSplit]  # by task
    own_splits: tuple[Split, ...] = ()  # those of them that the release does not publish
    policies: Annotated[dict[str, Sha256], Field(min_length=1)]

    @property
    def content_sha256(self) -> str:
        """The sha256 of its content, as it should be recorded."""
        bare = {"lock_version", "sha256"}
        return json_sha256(self.model_dump(mode="json", exclude=bare, exclude_unset=True))

    @property
    def pins(self) -> dict[str, object]:
        """Values that a registry must have, by the names of `_pinnable`."""
        own = {split.id for split in self.own_splits}
        splits = {split.id: split.sha256 for split in self.splits.values() if split.id not in own}
        return {
            **_named("environment version of", self.environments),
            **_named("split", splits),
            **_named("policy", self.policies),
            **_named("entry", self.leaves),
        }


def read_lock(path: Path) -> Lock:
    """Return the lock of a file.

    Raises:
        LockError: It is missing, malformed, of another version, or was edited.
    """
    text = read_text(path, MAX_LOCK_BYTES, LockError, "lock file", _REMEDY)
    try:
        version = parse_json(text)["lock_version"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _bad(path, "a lock file", f"{type(error).__name__}: {shorten(str(error))}") from None
    if version != LOCK_VERSION:
        expected = f"lock version {LOCK_VERSION}"
        found = f"version {shorten(version)}"
        raise _bad(path, expected, found, "upgrade assistax-zoo, or make the lock again")
    try:
        lock = Lock.model_validate_json(text)
    except ValidationError as error:
        raise _bad(path, "a lock file", first_problem(error)) from None
    if (digest := lock.content_sha256) != lock.sha256:
        raise _bad(path, f"content of sha256 {lock.sha256}", f"sha256 {digest}: it was edited")
    return lock


def apply_lock(registry: Registry, lock: Lock, *, task: str, split: str | None = None) -> Registry:
    """Return the registry with the pinned entries alone, so that nothing else can be loaded.

    Args:
        registry: The registry of this machine.
        lock: The lock.
        task: Task that is about to be evaluated.
        split: The split that the user names, if any: only the pinned one is allowed, or a side.

    Raises:
        LockError: The registry differs in something pinned, or another task or split is asked for.
    """
    _check(registry, lock)
    registry = _with_own_splits(registry, lock)
    if task not in lock.environments:
        expected = f"a task of the lock ({listing(lock.environments)})"
        raise LockError(f"task {shorten(task)}", expected, "another", "make a lock of it")
    _check_split(registry, lock, task, split)
    release = registry.data.releases[lock.release]
    defaults = {task: pinned.id for task, pinned in lock.splits.items()}
    tables = release.persons.items()
    persons = {"persons": {t: table for t, table in tables if persons_leaf(t) in lock.leaves}}
    entries = [entry for entry in registry.policies if entry.id in lock.policies]
    keep = {entry.team for entry in entries}
    data = registry.data
    teams = data.teams.items()
    fields = {
        "release": lock.release,
        "releases": {lock.release: release.model_copy(update={"splits": defaults, **persons})},
        "shards": {entry.shard: data.shards[entry.shard] for entry in entries},
        "teams": {name: _narrowed(name, team, lock) for name, team in teams if name in keep},
        "egos": {name: ego for name, ego in data.egos.items() if name in keep},
        "splits": tuple(split for split in data.splits if split.id in defaults.values()),
    }
    return dataclasses.replace(
        build_registry(data.model_copy(update=fields), registry.path),
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
    present = _pinnable(registry, lock)
    for name, value in lock.pins.items():
        if present.get(name) != value:
            raise _differs(registry, f"{name} {value}", str(present.get(name, "none")))


def _pinnable(registry: Registry, lock: Lock) -> dict[str, object]:
    """Return all that a lock of its release can pin, by the names of `Lock.pins`."""
    part, name = registry.part_of(lock.release)
    data, as_locked = registry.data, _as_locked(registry, lock)
    splits = {split.id: split.sha256 for split in data.splits}
    for task, pinned in lock.splits.items():
        with contextlib.suppress(ZooError):  # of persons, which nothing stores
            splits.setdefault(pinned.id, as_locked.split(task, pinned.id).sha256)
    return {
        **_named("environment version of", data.releases[lock.release].environments),
        **_named("split", splits),
        **_named("policy", {entry.id: entry.sha256 for entry in registry.policies}),
        **_named("entry", leaves(part.data, name)),
    }


def _named(kind: str, values: Mapping[str, object]) -> dict[str, object]:
    return {f"{kind} {name}": value for name, value in values.items()}


def _with_own_splits(registry: Registry, lock: Lock) -> Registry:
    """Return the registry with the splits that stand in the lock whole, beside its own."""
    known = {split.id for split in registry.splits}
    splits = [split for split in lock.own_splits if split.id not in known]
    data = registry.data.model_copy(update={"splits": (*registry.splits, *splits)})
    return dataclasses.replace(registry, data=data, parts=registry.parts or {"": registry})


def _as_locked(registry: Registry, lock: Lock) -> Registry:
    """Return the registry with the lock's teams and defaults, by which splits of persons are made.

    A release may have more teams since.
    """
    data, release = registry.data, registry.data.releases[lock.release]
    teams = {n: team for n, team in data.teams.items() if f"{n}/human" in lock.policies}
    splits = {task: pinned.id for task, pinned in lock.splits.items()}
    named = {lock.release: release.model_copy(update={"splits": {**release.splits, **splits}})}
    fields = {"teams": teams, "releases": {**data.releases, **named}}
    return dataclasses.replace(registry, data=data.model_copy(update=fields))


def _differs(registry: Registry, expected: str, found: str) -> LockError:
    advice = "fetch what was locked (`assistax-zoo fetch`), or lock anew"
    return LockError(f"registry {registry.path}", f"{expected}, as locked", found, advice)


def _bad(path: Path, expected: str, found: str, advice: str = _REMEDY) -> LockError:
    return LockError(f"lock file {path}", expected, found, advice)


def _check_split(registry: Registry, lock: Lock, task: str, split: str | None) -> None:
    name, _ = parse_split(split, registry.parts)
    if name is None:
        return
    pinned, chosen = lock.splits.get(task), name
    with contextlib.suppress(ZooError):
        chosen = _as_locked(registry, lock).split(task, name).id
    if pinned is None or chosen != pinned.id:
        expected = f"the locked one ({pinned.id if pinned else 'none'})"
        advice = "name no split, or only a side: test, train or both"
        raise LockError(f"split {shorten(name)}", expected, chosen, advice)
