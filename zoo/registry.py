"""The registry: loaded, validated, and asked for policies and splits."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from pydantic import ValidationError

from zoo.cache import cached_shard
from zoo.errors import RegistryError, RegistryVersionError, SplitError, listing, nearest, shorten
from zoo.files import atomic_write, read_registry_text, registry_path, shard_root
from zoo.ids import parse_team
from zoo.schema import (
    SCHEMA_VERSION,
    PolicyEntry,
    RegistryFile,
    Split,
    Team,
    dump_registry,
    first_problem,
)
from zoo.selection import refuse_unknown, select
from zoo.splits import check_split, refuse_leak, shared_parameters


@dataclasses.dataclass(frozen=True)
class Registry:
    """A validated registry and where it lies."""

    data: RegistryFile
    path: Path
    policies: list[PolicyEntry] = dataclasses.field(
        repr=False
    )  # by task, algorithm, disability, seed, release, role
    lock: str | None = None  # sha256 of the lock file that it was narrowed down to, see `zoo.lock`

    @property
    def release(self) -> str:
        """Name of the newest whole release, whose splits are the default."""
        return self.data.release

    @property
    def splits(self) -> tuple[Split, ...]:
        """Every published split; use `split` for a verified one."""
        return self.data.splits

    def shard_path(self, shard: str) -> Path:
        """Return where a shard lies on this machine: beside the registry, else in the cache if it was fetched."""
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
        refuse_unknown(policy_id, [entry.id for entry in self.policies])

    def env_version(self, entry: PolicyEntry) -> int:
        """Return the version of its task's environment that a policy was trained on."""
        return self.data.releases[entry.release].environments[entry.task]

    def team(self, team_id: str) -> Team:
        """Return one team by its id.

        Raises:
            UnknownIdError: The registry has no such team; the nearest ids are named.
        """
        if team_id not in self.data.teams:
            refuse_unknown(team_id, list(self.data.teams), "team")
        return self.data.teams[team_id]

    def select(
        self,
        pattern: str | Sequence[str] | None = None,
        *,
        task: str | None = None,
        algorithm: str | None = None,
        disability: str | None = None,
        role: str | None = None,
        release: str | None = None,
    ) -> list[PolicyEntry]:
        """Return the policies that match, in registry order; the arguments are those of `zoo.selection.select`.

        Raises:
            UnknownIdError: Nothing matches; the nearest ids are named.
        """
        return select(
            self.policies,
            pattern,
            task=task,
            algorithm=algorithm,
            disability=disability,
            role=role,
            release=release,
        )

    def split(self, task: str, id: str | None = None, *, release: str | None = None) -> Split:
        """Return a verified split: the one named, or the default of the release (the newest if not given).

        Args:
            task: Task the split is for.
            id: A split's id, or its beginning: that of one split alone ("half-s0-v0"), or of one
                alone of the newest release ("half").
            release: Release whose default split is meant when `id` is not given.

        Raises:
            SplitError: There is no such split, or its content differs from its sha256.
            LeakageError: A team, or the same parameters, stand on both sides.
        """
        split = (
            self._named_split(task, id)
            if id
            else self._default_split(task, release or self.release)
        )
        check_split(split)
        missing = [team for team in (*split.train, *split.test) if team not in self.data.teams]
        if missing:
            raise _split_error(
                f"split {split.id}", "teams of the registry", f"unknown {listing(missing)}"
            )
        pairs = shared_parameters(split.train, split.test, self.data.teams)
        return refuse_leak(split.id, pairs) if pairs else split

    def _named_split(self, task: str, name: str) -> Split:
        known = [split for split in self.splits if split.task == task]
        full = name if "/" in name else f"{task}/{name}"
        exact = [split for split in known if split.id == full]
        found = exact or [split for split in known if split.id.startswith(full)]
        for candidates in (found, [split for split in found if split.release == self.release]):
            if len(candidates) == 1:
                return candidates[0]
        ids = [split.id for split in known]
        close = nearest(full, ids) or ids
        what = f"{len(found)} that begin so" if found else "none"
        raise _split_error(
            f"split {shorten(name)} of task {shorten(task)}", f"one split ({listing(close)})", what
        )

    def _default_split(self, task: str, release: str) -> Split:
        if release not in self.data.releases:
            allowed = f"one of {listing(self.data.releases)}"
            raise _split_error(f"release {shorten(release)}", allowed, "no such release")
        defaults = self.data.releases[release].splits
        if task not in defaults:
            allowed = f"a default split (release {release} has one for {listing(sorted(defaults))})"
            raise _split_error(f"task {shorten(task)}", allowed, "none")
        return next(split for split in self.splits if split.id == defaults[task])


def load_registry(path: Path | str | None = None) -> Registry:
    """Return the registry at `path`.

    Without a path: `$ASSISTAX_ZOO_REGISTRY`, else the checkout's `registry.json`, else the one in
    the wheel.

    Raises:
        RegistryError: The file is missing or is not of the schema.
        RegistryVersionError: The file is of a newer schema.
    """
    found = registry_path(path)
    return build_registry(parse_registry(read_registry_text(found), str(found)), found)


def parse_registry(text: str, source: str) -> RegistryFile:
    """Return the validated content of a registry's text; `source` names it in errors."""
    try:
        version = json.loads(text, object_pairs_hook=_unique)["schema_version"]
        if type(version) is not int:
            raise ValueError(f"schema_version {shorten(version)}")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise _registry_error(source, f"not a registry ({type(error).__name__}: {error})") from None
    if version > SCHEMA_VERSION:
        raise RegistryVersionError(
            f"registry {source}",
            expected=f"schema version {SCHEMA_VERSION} or older",
            found=f"schema version {version}",
            done="nothing was loaded",
            next_step="upgrade with `pip install --upgrade assistax-zoo`",
        )
    try:
        return RegistryFile.model_validate_json(text)
    except ValidationError as error:
        raise _registry_error(source, first_problem(error)) from None


def build_registry(data: RegistryFile, path: Path) -> Registry:
    """Return the registry with its policies resolved and in order."""
    teams = sorted(
        ((parse_team(team), entry) for team, entry in data.teams.items()),
        key=lambda pair: pair[0].order,
    )
    settings = {name: setting.value() for name, setting in data.disability_settings.items()}
    policies = []
    for team, entry in teams:
        for role, place in sorted(entry.policies.items(), reverse=True):
            policy = PolicyEntry(
                id=f"{team}/{role}",
                team=str(team),
                task=team.task,
                algorithm=team.algorithm,
                role=role,
                disability=team.disability,
                setting=settings[team.disability],
                seed=team.seed,
                release=team.release,
                spec=data.shards[place.shard].spec,
                shard=place.shard,
                row=place.row,
                sha256=place.sha256,
                run=entry.run,
                training=data.runs[entry.run],
                self_play=entry.self_play,
            )
            policies.append(policy)
    return Registry(data=data, path=path, policies=policies)


def save_registry(data: RegistryFile, path: Path) -> Registry:
    """Validate the content once more as text, write it atomically, and return it as a registry."""
    text = dump_registry(data)
    registry = build_registry(parse_registry(text, str(path)), path)
    atomic_write(path, text.encode())
    return registry


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    table = dict(pairs)
    if len(table) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(
            f"key {next(name for name in names if names.count(name) > 1)!r} twice in one object"
        )
    return table


def _registry_error(source: str, found: str) -> RegistryError:
    return RegistryError(
        f"registry {source}",
        expected=f"a registry of schema version {SCHEMA_VERSION}",
        found=found,
        done="nothing was loaded",
        next_step="restore the file from the repository, or upgrade assistax-zoo if a newer version wrote it",
    )


def _split_error(problem: str, expected: str, found: str) -> SplitError:
    return SplitError(
        problem,
        expected=expected,
        found=found,
        done="no split was loaded",
        next_step="`assistax-zoo split list` prints the splits, `assistax-zoo split create` makes one",
    )
