"""Holding every published byte against the registry, and the registry against itself."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

from assistax_base.errors import ZooError, listing, shorten
from assistax_envs.disability import DISABILITY_SETTINGS
from assistax_envs.versions import VERSIONS
from population.networks.tensors import StackedFile, damaged_row, row_sha256, take_row
from zoo.history.merkle import root_problems
from zoo.history.signing import check_signature
from zoo.ids import parse_team, release_number, same_team
from zoo.locations import shard_root
from zoo.parameters.storage import read_shard
from zoo.registry import Registry
from zoo.schema import DisabilitySetting, PolicyEntry


@dataclasses.dataclass(frozen=True)
class Report:
    """Counts and findings of `verify`; its notes are no failures."""

    registry: str
    release: str
    shards: int
    bytes: int
    policies: int
    splits: int
    persons: int  # of all tasks and releases, their tables made here and compared
    roots: dict[str, str]  # by release, as the registry's content gives them
    problems: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Return whether no problem was found."""
        return not self.problems


def verify(registry: Registry, *, key: Path | None = None) -> Report:
    """Check all shards, rows, splits, roots and duplicates of a registry; report every problem.

    Args:
        registry: A loaded registry; its ids and references were checked on loading.
        key: Ed25519 public key, PEM, that every release must be signed by.
    """
    registry = registry.part("")
    data = registry.data
    problems = [*root_problems(data), *_shards_problems(registry)]
    problems += [*_duplicates(registry), *_split_problems(registry)]
    problems += [problem for source in registry.sources for problem in source.problems()]
    if key:
        problems += _signature_problems(registry, key)
    if data.disability_settings != installed_settings():
        problems.append(
            "disability settings of the registry differ from those of the installed environments"
        )
    return Report(
        registry=str(registry.path),
        release=registry.release,
        shards=len(data.shards),
        bytes=sum(shard.bytes for shard in data.shards.values()),
        policies=len(registry.policies),
        splits=len(data.splits),
        persons=sum(size for source in registry.sources for size in source.table_sizes()),
        roots={release: registry.root(release) for release in data.releases},
        problems=tuple(problems),
        notes=tuple(_notes(registry)),
    )


def _shards_problems(registry: Registry) -> Iterator[str]:
    """Yield the problems of every shard; of a wheel, which has no shards, a single line."""
    shards = list(registry.data.shards)
    absent = [shard for shard in shards if not registry.shard_path(shard).is_file()]
    if absent and len(absent) == len(shards):
        yield (
            f"all {len(shards)} shards are missing, no file at "
            f"{registry.shard_path(shards[0])}: `assistax-zoo fetch` brings them"
        )
        return
    for shard in shards:
        yield from _shard_problems(registry, shard)


def _signature_problems(registry: Registry, key: Path) -> list[str]:
    problems = [
        check_signature(name, registry.root(name), release.signature, key)
        for name, release in registry.data.releases.items()
    ]
    return [problem for problem in problems if problem]


def _shard_problems(registry: Registry, shard: str) -> Iterator[str]:
    entries = [entry for entry in registry.policies if entry.shard == shard]
    rows = sorted(entry.row for entry in entries)
    if rows != list(range(registry.data.shards[shard].rows)):
        count = registry.data.shards[shard].rows
        yield f"shard {shard}: its {count} rows are not one policy each (rows {rows[:20]})"
    try:
        stacked = read_shard(registry, shard)
    except ZooError as error:
        yield str(error)
        return
    for entry in entries:
        yield from _row_problems(stacked, entry)


def _row_problems(stacked: StackedFile, entry: PolicyEntry) -> Iterator[str]:
    digest = row_sha256(take_row(stacked, entry.row))
    if digest != entry.sha256:
        yield str(damaged_row(entry.id, entry.sha256, digest))
    recorded = stacked.rows[entry.row]
    if recorded != {"id": entry.id, "sha256": entry.sha256}:
        yield (
            f"shard {entry.shard} records {shorten(recorded)} at row {entry.row}, "
            f"the registry {entry.id}"
        )


def _duplicates(registry: Registry) -> Iterator[str]:
    first: dict[tuple[str, str], PolicyEntry] = {}
    for entry in registry.policies:
        other = first.setdefault((entry.role, entry.sha256), entry)
        if not same_team(other.team, entry.team):
            yield f"{entry.id} has the same parameters as {other.id}"


def _split_problems(registry: Registry) -> Iterator[str]:
    for split in registry.splits:
        try:
            registry.split(split.task, split.id)
        except ZooError as error:
            yield str(error)


def _notes(registry: Registry) -> Iterator[str]:
    for name, release in registry.data.releases.items():
        for task, version in release.environments.items():
            if version != VERSIONS.get(task):
                here = VERSIONS.get(task, "none")
                yield (
                    f"release {name} was trained on {task} version {version}; installed is {here}"
                )
            teams = [team for team in registry.data.teams if parse_team(team).release == name]
            dealt = {*release.splits, *release.persons}
            if task not in dealt and any(team.startswith(f"{task}/") for team in teams):
                newer = release_number(name) > release_number(registry.release)
                reason = "it is not whole yet" if newer else "one of its halves would be empty"
                yield f"release {name} has no default split for {task}: {reason}"
    root = shard_root(registry.path)
    stored = {path.relative_to(root).as_posix() for path in root.glob("zoo/shards/*/*.safetensors")}
    stray = sorted(stored - set(registry.data.shards))
    if stray:
        yield f"files in no registry, left by an interrupted publication: {listing(stray)}"


def installed_settings() -> dict[str, DisabilitySetting]:
    """Return the disability settings of the installed environments."""
    return {
        name: DisabilitySetting(**dataclasses.asdict(setting))
        for name, setting in DISABILITY_SETTINGS.items()
    }
