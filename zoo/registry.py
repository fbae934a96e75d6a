"""The registry: loaded, validated, and asked for policies and splits."""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from pydantic import ValidationError

from assistax_base.bounded_reading import MAX_REGISTRY_BYTES, parse_json, read_text
from assistax_base.errors import (
    RegistryError,
    RegistryVersionError,
    SplitError,
    listing,
    shorten,
)
from assistax_base.validated import first_problem
from population.networks.spec import ROLES
from zoo.history.merkle import check_roots, release_root
from zoo.history.own_splits import own_splits
from zoo.ids import parse_team, with_release
from zoo.locations import (
    REGISTRY_VARIABLE,
    added_registries,
    cached_shard,
    packaged_shard,
    registry_path,
    shard_root,
)
from zoo.namespaces import merge, split_namespace
from zoo.partners.asking import asked_source
from zoo.partners.kinds import kinds
from zoo.partners.source import PartnerSource
from zoo.schema import SCHEMA_VERSION, Ego, PolicyEntry, RegistryFile, Split, Team
from zoo.selection import refuse_unknown, select

if TYPE_CHECKING:
    from population.networks.stack import PolicyStack

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Registry:
    """A validated registry and where it lies, with the zoos that were added to it."""

    data: RegistryFile  # with the entries of other zoos under their namespaces
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
        """Return where a shard lies: beside the registry, in its data package, or in the cache."""
        namespace, path = split_namespace(shard)
        if namespace:
            return self.parts[namespace].shard_path(path)
        beside = shard_root(self.path) / shard
        if beside.is_file() or shard not in self.data.shards:
            return beside
        entry = self.data.shards[shard]
        fetched = cached_shard(entry.sha256)
        packaged = packaged_shard(entry.task, entry.sha256)
        return packaged or (fetched if fetched.is_file() else beside)

    @functools.cached_property
    def sources(self) -> tuple[PartnerSource, ...]:
        """The kinds of partners: teams, persons, then those of installed packages."""
        return tuple(kind(self) for kind in kinds())

    @property
    def teams(self) -> PartnerSource:
        """The source of teams, whose parameters the shards hold."""
        return self.sources[0]

    def source_of(self, name: str) -> PartnerSource:
        """Return the source of the partners that an id or a glob names."""
        return next((source for source in self.sources[1:] if source.owns(name)), self.teams)

    def source_of_split(self, split: Split) -> PartnerSource:
        """Return the source of the partners that a split deals."""
        return next((source for source in self.sources if source.word == split.rule), self.teams)

    def source_asked(
        self, split: str | None, patterns: str | Sequence[str] | None
    ) -> PartnerSource | None:
        """Return the source that a split's name or all patterns over partners ask for by name.

        Returns:
            None if they name no kind, so that teams, or the task's default partners, are meant.

        Raises:
            ValueError: The patterns are of several kinds, or one can be of no partner.
        """
        texts = [patterns] if isinstance(patterns, str) else list(patterns or ())
        return asked_source(self.sources, split, texts)

    @functools.cached_property
    def _by_id(self) -> dict[str, PolicyEntry]:
        return {entry.id: entry for entry in self.policies}

    def policy(self, policy_id: str) -> PolicyEntry:
        """Return one policy by its id; without a role, the only policy of that team or person.

        Raises:
            UnknownIdError: The registry has no such policy; the nearest ids are named.
        """
        policy_id = self.full(policy_id)
        if policy_id in self._by_id:
            return self._by_id[policy_id]
        found = self.known([policy_id, *(f"{policy_id}/{role}" for role in ROLES)])
        if len(found) == 1:
            return found[0]
        self.source_of(policy_id).select([policy_id])  # its kind may say more of the id
        refuse_unknown(policy_id, list(self._by_id))

    def known(self, ids: Iterable[str]) -> list[PolicyEntry]:
        """Return the entries of `ids`, skipping unknown ones: teams first, in registry order."""
        wanted = self._by_source(dict.fromkeys(ids), self.source_of)
        return [entry for source, names in wanted for entry in source.known(names)]

    def stacks(self, entries: Iterable[PolicyEntry]) -> "tuple[PolicyStack, ...]":
        """Return the parameters of entries, verified, one stack for each spec: teams first."""
        chosen = self._by_source(entries, lambda entry: self.source_of(entry.id))
        return tuple(stack for source, some in chosen for stack in source.stacks(some))

    def _by_source(
        self, items: Iterable[T], source_of: Callable[[T], PartnerSource]
    ) -> list[tuple[PartnerSource, list[T]]]:
        """Return each source that has any of the items, with its items in their order."""
        dealt: dict[PartnerSource, list[T]] = {source: [] for source in self.sources}
        for item in items:
            dealt[source_of(item)].append(item)
        return [(source, some) for source, some in dealt.items() if some]

    def env_version(self, entry: PolicyEntry) -> int:
        """Return the version of its task's environment that a policy was trained on."""
        release = self.data.releases.get(entry.release)
        environments = release.environments if release else {}
        return environments.get(entry.task, entry.training.env_version)

    def root(self, release: str) -> str:
        """Return the root over all entries of a release here, by which results name the release."""
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
        team_id = self.full(team_id)
        if team_id not in self.data.teams:
            refuse_unknown(team_id, list(self.data.teams), "team")
        return self.data.teams[team_id]

    def select(
        self, pattern: str | Sequence[str] | None = None, **fields: Any
    ) -> list[PolicyEntry]:
        """Return the policies that match, in registry order, as `zoo.selection.select` does.

        Partners of another kind than teams match if a pattern says so, such as
        "gentle_scratch/person-*". They come last.

        Raises:
            UnknownIdError: Nothing matches; the nearest ids are named.
        """
        if pattern is None:
            return select(self.policies, **fields)
        names = [pattern] if isinstance(pattern, str) else pattern
        patterns = [self.full(name, fields.get("release")) for name in names]
        chosen: list[PolicyEntry] = []
        for source, some in self._by_source(patterns, self.source_of):
            chosen += select(source.candidates(some), some, **fields)
        return chosen

    def full(self, name: str, release: str | None = None) -> str:
        """Return an id or glob with a release where it names none: the task's default if None."""

        def release_of(task: str, namespace: str) -> str:
            return release or self.release_of(task, namespace if namespace in self.parts else "")

        return with_release(name, release_of)

    def of_task(self, task: str, role: str) -> list[PolicyEntry]:
        """Return a task's robots or humans, those of its default release, in registry order.

        Raises:
            UnknownIdError: The release has no such policies. The error names the allowed values.
        """
        return self.select(task=task, role=role, release=self.release_of(task))

    def split(self, task: str, id: str | None = None, *, release: str | None = None) -> Split:
        """Return a verified split: the one named, or a release's default (the task's own).

        If a release has no stored default split, it is that of its persons, or of another kind.

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
        sources = self.sources
        # A kind knows the names of its splits; every other name is of a stored split.
        asked = (*sources[1:], sources[0]) if id else sources
        release = None if id else release or self.release_of(task)
        for source in asked:
            if split := source.split(task, id or None, release):
                return split
        having = sorted(self.data.releases[release].splits) if release in self.data.releases else ()
        allowed = f"a default split (release {release} has one for {listing(having)})"
        raise SplitError(f"task {shorten(task)}", allowed, "none")


def load_registry(path: Path | str | None = None, *, roots: bool = True) -> Registry:
    """Return the registry at `path`, alone; or the default one, with all that the user added.

    The default is `$ASSISTAX_ZOO_REGISTRY`, else the checkout's `registry.json`, else the one in
    the wheel.

    Args:
        path: Registry to read instead of the default one.
        roots: Refuse a registry whose entries are not those of its roots. False is for commands
            that report the problems of a registry.

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
    source = f"registry {source}"
    expected = f"a registry of schema version {SCHEMA_VERSION}"
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
    text = read_text(path, MAX_REGISTRY_BYTES, RegistryError, "registry", remedy)
    return _registry_of(text, path, roots)


@functools.lru_cache(maxsize=2)  # one process reads the same file again and again
def _registry_of(text: str, path: Path, roots: bool) -> Registry:
    data = parse_registry(text, str(path))
    if roots:
        check_roots(data, str(path))
    return build_registry(data, path)
