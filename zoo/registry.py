"""The registry: loaded, validated, and asked for policies and splits."""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from assistax_base.bounded_reading import MAX_REGISTRY_BYTES, parse_json, read_text
from assistax_base.errors import (
    RegistryError,
    RegistryVersionError,
    SplitError,
    listing,
    nearest,
    shorten,
)
from assistax_base.validated import first_problem
from zoo.history.merkle import check_roots, release_root
from zoo.history.own_splits import own_splits
from zoo.ids import PERSONS, names_persons, parse_team
from zoo.locations import (
    REGISTRY_VARIABLE,
    added_registries,
    cached_shard,
    registry_path,
    shard_root,
)
from zoo.namespaces import merge, qualify_split, split_namespace
from zoo.schema import SCHEMA_VERSION, Ego, PolicyEntry, RegistryFile, Split, Team
from zoo.selection import refuse_unknown, select
from zoo.splits import check_split, leaks, refuse_leak


@dataclasses.dataclass(frozen=True)
class Registry:
    """A validated registry and where it lies, with the zoos that were added to it."""

    data: RegistryFile  # what other zoos published stands in it under their namespace
    path: Path
    # By namespace, task, algorithm, disability, seed, release, role.
    policies: list[PolicyEntry] = dataclasses.field(repr=False)
    lock: str | None = None  # sha256 of the lock file that it was narrowed down to, see `zoo.lock`
    parts: Mapping[str, "Registry"] = dataclasses.field(  # by namespace, "" is its own
        default_factory=dict, repr=False
    )

    @property
    def release(self) -> str:
        """Name of the newest whole release."""
        return self.data.release

    def release_of(self, task: str, namespace: str = "") -> str:
        """Return a task's default release, of one zoo: the newest whole one that has it."""
        if not namespace or self.lock:
            return self.data.release_of(task)
        return f"{namespace}:{self.part(namespace).data.release_of(task)}"

    @property
    def splits(self) -> tuple[Split, ...]:
        """Every published split; use `split` for a verified one."""
        return self.data.splits

    def shard_path(self, shard: str) -> Path:
        """Return where a shard lies: beside the registry, or in the cache if it was fetched."""
        namespace, path = split_namespace(shard)
        if namespace:
            return self.parts[namespace].shard_path(path)
        beside = shard_root(self.path) / shard
        if beside.is_file() or shard not in self.data.shards:
            return beside
        fetched = cached_shard(self.data.shards[shard].sha256)
        return fetched if fetched.is_file() else beside

    def policy(self, policy_id: str) -> PolicyEntry:
        """Return one policy by its id.

        Raises:
            UnknownIdError: The registry has no such policy; the nearest ids are named.
        """
        for entry in self.policies:
            if entry.id == policy_id:
                return entry
        if names_persons(policy_id) and (someone := self.known([policy_id])):
            return someone[0]
        refuse_unknown(policy_id, [entry.id for entry in self.policies])

    def known(self, ids: Iterable[str]) -> list[PolicyEntry]:
        """Return the policies of these ids that there are: in registry order, then persons."""
        wanted = dict.fromkeys(ids)
        entries = [entry for entry in self.policies if entry.id in wanted]
        named = [name for name in wanted if names_persons(name) and name.endswith("/human")]
        if named:
            from zoo.persons.registered import known_persons  # which makes rows by NumPy

            entries += known_persons(self.data, named)
        return entries

    def env_version(self, entry: PolicyEntry) -> int:
        """Return the version of its task's environment that a policy was trained on."""
        return self.data.releases[entry.release].environments[entry.task]

    def root(self, release: str) -> str:
        """Return the root over all that a release holds here: what a result is traced to."""
        part, name = self.part_of(release)
        return release_root(part.data, name)

    def part_of(self, key: str) -> tuple["Registry", str]:
        """Return the registry of the zoo that a key names, and the key there."""
        namespace, name = split_namespace(key)
        return self.part(namespace), name

    def part(self, namespace: str) -> "Registry":
        """Return the registry of one zoo alone: an added one, or "" for its own."""
        return self.parts.get(namespace, self)

    def team(self, team_id: str) -> Team:
        """Return one team by its id.

        Raises:
            UnknownIdError: The registry has no such team; the nearest ids are named.
        """
        if team_id not in self.data.teams:
            refuse_unknown(team_id, list(self.data.teams), "team")
        return self.data.teams[team_id]

    def select(
        self, pattern: str | Sequence[str] | None = None, **fields: Any
    ) -> list[PolicyEntry]:
        """Return the policies that match, in registry order, as `zoo.selection.select` does.

        Persons are meant where a pattern says so, as "gentle_scratch/person-*-v3", and come last.

        Raises:
            UnknownIdError: Nothing matches; the nearest ids are named.
        """
        patterns = [pattern] if isinstance(pattern, str) else list(pattern or ())
        named = [text for text in patterns if names_persons(text)]
        if not named:
            return select(self.policies, pattern, **fields)
        from zoo.persons.registered import select_persons

        others = [text for text in patterns if text not in named]
        chosen = select(self.policies, others, **fields) if others else []
        return [*chosen, *select(select_persons(self.data, named), named, **fields)]

    def of_task(self, task: str, role: str) -> list[PolicyEntry]:
        """Return a task's robots or humans, those of its default release, in registry order.

        Raises:
            UnknownIdError: The release has none; what there is is named.
        """
        return self.select(task=task, role=role, release=self.release_of(task))

    def split(self, task: str, id: str | None = None, *, release: str | None = None) -> Split:
        """Return a verified split: the one named, or a release's default (the task's own).

        The default of a release that has persons of the task alone is theirs.

        Args:
            task: Task the split is for.
            id: A split's id, or its first parts: those of one split alone ("half-s0-v1"), else of
                one alone that is a release's default, else of one of the task's default release
                ("half"). Of a zoo that was added, after its namespace: "lab:half"; "lab:" is its
                default split.
            release: Release whose default split is meant when `id` is not given.

        Raises:
            SplitError: There is no such split, or its content differs from its sha256.
            LeakageError: A team, or the same parameters, stand on two sides.
        """
        if PERSONS in (id or ""):
            from zoo.persons.registered import person_split

            if dealt := person_split(self.data, task, str(id)):
                return dealt
        namespace, name = split_namespace(id or release or "")
        if namespace in self.parts and namespace:
            arguments = {"id": name or None} if id else {"release": name}
            theirs = qualify_split(self.parts[namespace].split(task, **arguments), namespace)
            if theirs not in self.splits and theirs.rule != PERSONS:  # narrowed down by a lock
                raise SplitError(f"split {theirs.id}", "one of this registry", "none")
            return theirs
        split = (
            self._named_split(task, id)
            if id
            else self._default_split(task, release or self.release_of(task))
        )
        if split.rule == PERSONS:  # made here just now, and of no team
            return split
        check_split(split)
        teams = self.data.teams
        if missing := [team for side in split.sides.values() for team in side if team not in teams]:
            raise SplitError(
                f"split {split.id}", "teams of the registry", f"unknown {listing(missing)}"
            )
        return refuse_leak(split.id, pairs) if (pairs := leaks(split, teams)) else split

    def _named_split(self, task: str, name: str) -> Split:
        known = [split for split in self.splits if split.task == task]
        full = name if "/" in name else f"{task}/{name}"
        exact = [split for split in known if split.id == full]
        matching = exact or [split for split in known if split.id.startswith(f"{full}-")]
        newest = self.release_of(task)
        # A split that somebody made since does not change what the name of a default one means.
        defaults = {id for release in self.data.releases.values() for id in release.splits.values()}
        default = [split for split in matching if split.id in defaults]
        its = [[split for split in some if split.release == newest] for some in (default, matching)]
        for candidates in (matching, default, *its):
            if len(candidates) == 1:
                return candidates[0]
        ids = [split.id for split in known]
        close = nearest(full, ids) or ids
        raise SplitError(
            f"split {shorten(name)} of task {shorten(task)}",
            f"one split ({listing(close)})",
            f"{len(matching)} that begin so" if matching else "none",
        )

    def _default_split(self, task: str, release: str) -> Split:
        if release not in self.data.releases:
            allowed = f"one of {listing(self.data.releases)}"
            raise SplitError(f"release {shorten(release)}", allowed, "no such release")
        entry = self.data.releases[release]
        if task in entry.splits:
            return next(split for split in self.splits if split.id == entry.splits[task])
        if task in entry.persons:
            return self.split(task, f"{PERSONS}-s0-{release}")
        allowed = f"a default split (release {release} has one for {listing(sorted(entry.splits))})"
        raise SplitError(f"task {shorten(task)}", allowed, "none")


def load_registry(path: Path | str | None = None, *, roots: bool = True) -> Registry:
    """Return the registry at `path`, alone; or the default one, with all that the user added.

    The default is `$ASSISTAX_ZOO_REGISTRY`, else the checkout's `registry.json`, else the one in
    the wheel.

    Args:
        path: Registry to read instead of the default one.
        roots: Refuse a registry whose entries are not those of its roots; False is for who reports
            what is wrong with it.

    Raises:
        RegistryError: A file is missing or is not of the schema.
        RegistryVersionError: A file is of a newer schema.
        IntegrityError: An entry of a release was changed, added or removed.
    """
    base = read_registry(registry_path(path), roots)
    if path is not None:
        return base
    added = {
        namespace: read_registry(file, roots) for namespace, file in added_registries().items()
    }
    splits = own_splits(base.data)
    if not added and not splits:
        return base
    data = merge(base.data, {namespace: part.data for namespace, part in added.items()})
    data = data.model_copy(update={"splits": (*data.splits, *splits)})
    return dataclasses.replace(build_registry(data, base.path), parts={"": base, **added})


def parse_registry(text: str, source: str) -> RegistryFile:
    """Return the validated content of a registry's text; `source` names it in errors."""
    source, expected = f"registry {source}", f"a registry of schema version {SCHEMA_VERSION}"
    try:
        version = parse_json(text)["schema_version"]
        if type(version) is not int:
            raise ValueError(f"schema_version {shorten(version)}")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        found = f"not a registry ({type(error).__name__}: {error})"
        raise RegistryError(source, expected, found) from None
    if version > SCHEMA_VERSION:
        found = f"schema version {version}"
        raise RegistryVersionError(source, f"schema version {SCHEMA_VERSION}", found)
    try:
        return RegistryFile.model_validate_json(text)
    except ValidationError as error:
        raise RegistryError(source, expected, first_problem(error)) from None


def build_registry(data: RegistryFile, path: Path) -> Registry:
    """Return the registry with its policies resolved and in order."""
    members = sorted(
        ((parse_team(team), entry) for team, entry in data.members.items()),
        key=lambda pair: pair[0].order,
    )
    settings = {name: setting.value() for name, setting in data.disability_settings.items()}
    policies = []
    for team, entry in members:
        prefix = f"{team.namespace}:" if team.namespace else ""
        for role, place in sorted(entry.policies.items(), reverse=True):
            policy = PolicyEntry(
                id=f"{team}/{role}",
                team=str(team),
                task=team.task,
                algorithm=team.algorithm,
                role=role,
                disability=team.disability,
                setting=settings.get(f"{prefix}{team.disability}"),
                seed=team.seed,
                release=f"{prefix}{team.release}",
                spec=data.shards[place.shard].spec,
                shard=place.shard,
                row=place.row,
                sha256=place.sha256,
                run=entry.run,
                training=data.runs[entry.run],
                self_play=entry.self_play if isinstance(entry, Team) else None,
                trained_against=entry.trained_against if isinstance(entry, Ego) else None,
            )
            policies.append(policy)
    return Registry(data=data, path=path, policies=policies)


def read_registry(path: Path, roots: bool = True) -> Registry:
    """Return the registry of one file, alone."""
    remedy = f"name another registry, also by ${REGISTRY_VARIABLE}, or restore it"
    return _registry_of(
        read_text(path, MAX_REGISTRY_BYTES, RegistryError, "registry", remedy), path, roots
    )


@functools.lru_cache(maxsize=2)  # one process reads the same file again and again
def _registry_of(text: str, path: Path, roots: bool) -> Registry:
    data = parse_registry(text, str(path))
    if roots:
        check_roots(data, str(path))
    return build_registry(data, path)
