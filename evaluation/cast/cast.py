"""The cast of a study: its robots and partners, loaded from a registry with their metadata.

A study asks its registry for nothing after its cast is made.
"""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

from assistax_base.errors import RegistryVersionError, listing
from assistax_envs.persons.rows import KNOWN_FAMILIES, TEAMS, UNSEEN_FAMILY
from assistax_envs.versions import TASKS, VERSIONS
from evaluation.cast.met_partners import MetPartners, declare, describe_met, met_partners
from evaluation.cast.roster import Roster, paired_rosters, registry_roster
from evaluation.record.manifest import describe_sources
from zoo.ids import EGO
from zoo.namespaces import plain_name, split_namespace
from zoo.partners.kinds import described_kind, kinds
from zoo.partners.sides import SIDES
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split


@dataclasses.dataclass(frozen=True, eq=False)
class Cast:
    """The robots of a study, the humans that they meet, and their published metadata."""

    task: str
    version: int  # of the task's environment that all policies play
    robots: Roster
    humans: Roster
    split: Split | None  # the humans' split; None if the population has no split
    groups: tuple[str, ...]  # of its test side, see `groups_beside_teams`
    sides: Mapping[str, str]  # human's id -> "train", "validation" or "test"
    releases: tuple[str, ...]  # of the published robots and humans, sorted
    lock: str | None  # sha256 of the lock that the registry was narrowed down to
    met: MetPartners  # which humans the robots met in training
    # Each human's training partner, beside the human, for baselines. None if no such robot is
    # published or no baseline is asked for.
    own_robots: tuple[Roster, Roster] | None
    baselines: bool  # whether baselines may be played
    # Fields of the manifest: the releases' roots, the robots' training partners, the sources.
    record: Mapping[str, Any]

    @classmethod
    def of(
        cls,
        registry: Registry,
        *,
        task: str,
        robots: Roster,
        humans: Sequence[PolicyEntry],
        split: Split | None = None,
        trained_with: str | Sequence[str] | None = None,
        baselines: bool = False,
    ) -> "Cast":
        """Return the cast of these robots and humans, with all that a study needs of a registry.

        Args:
            registry: The published partners.
            task: The task that they play.
            robots: The robots, see `evaluation.cast.egos.read_egos`.
            humans: The partners.
            split: The split that gives each partner its side.
            trained_with: The robots' training partners, see `zoo.met.claims.declared_met`.
            baselines: Whether to load each partner's own robot too, which baselines need.

        Raises:
            ValueError: `trained_with` is malformed, or contradicts the robots' records.
            ZooError: The registry lacks a policy, or policies are of different environment
                versions.
        """
        published = [entry for entry in registry.policies if entry.id in robots.members]
        version = version_of_all(registry, task, [*published, *humans], claimed_versions(robots))
        robots = declare(robots, registry, task, trained_with)
        entries = entries_of(registry, robots, humans, baselines)
        return cls(
            task=task,
            version=version,
            robots=robots,
            humans=registry_roster(registry, humans),
            split=split,
            groups=groups_beside_teams(split),
            sides=sides_of(humans, split),
            releases=tuple(sorted({entry.release for entry in (*published, *humans)} - {""})),
            lock=registry.lock,
            met=met_partners(robots, humans),
            own_robots=own_robots(registry, humans) if baselines else None,
            baselines=baselines,
            record={
                "registry": {"roots": roots_of(registry, entries), "lock": registry.lock},
                "met": describe_met(robots, trained_with),
                "sources": describe_sources(registry, entries, split.id if split else None, ()),
            },
        )


def choose_partners(
    registry: Registry,
    task: str,
    split: str | None,
    patterns: str | Sequence[str] | None,
    persons: int | None = None,
) -> tuple[Split, list[PolicyEntry]]:
    """Return the split that `split` names, and the humans of its sides that match `patterns`.

    Names and patterns say of which kind the partners are; if they do not, the kind is that of the
    task's default split. If `split` names no split, it is that of the release of the matching
    partners, or the task's default one if the partners are of several releases. At most `persons`
    partners are drawn, of a kind that makes its partners.

    Raises:
        ValueError: There is no such split, or its sides have no partner that matches.
    """
    its = plain_name(split or "").partition("/")
    if its[1] and its[0] in TASKS and its[0] != task:
        raise ValueError(f"split {split!r} is of task {its[0]}, not of {task}; name one of {task}")
    source = registry.source_asked(split, patterns)
    if source is None and not patterns and split in (None, *SIDES):
        source = registry.source_of_split(registry.split(task))
    return (source or registry.teams).choose(task, split, patterns, persons)


def leaves_the_choice(split: str | None, patterns: str | Sequence[str] | None) -> bool:
    """Return whether the arguments of `choose_partners` leave the choice to it.

    They name no partners, and a split at most by a side or by the word of a kind.
    """
    words = (kind.word for kind in kinds())
    return not patterns and (split or "").partition(":")[0] in ("", *SIDES, *words)


def in_release(
    registry: Registry, patterns: str | Sequence[str], release: str | None, *, task: str, role: str
) -> list[PolicyEntry]:
    """Return the policies of a task and role in a release that match, in registry order.

    The default release is the task's, in the zoo of each pattern. A pattern that names a release is
    looked up in all releases. Robots trained without a human of their own (egos) are included only
    if a pattern matches no team, as "scratch/*-ego-*" does.
    """
    matching: set[str] = set()
    for pattern in [patterns] if isinstance(patterns, str) else patterns:
        namespace = split_namespace(pattern)[0]
        default = release_in(
            registry, task, release, namespace if namespace in registry.parts else ""
        )
        named = re.search(r"-v\d+(/|$)", pattern)
        chosen = registry.select(pattern, task=task, role=role, release=None if named else default)
        teams = [entry for entry in chosen if entry.disability != EGO]
        matching |= {entry.id for entry in teams or chosen}
    return registry.known(matching)


def release_in(registry: Registry, task: str, release: str | None, namespace: str) -> str:
    """Return the release's full id in the zoo `namespace`; the task's default if it is None."""
    if release is None:
        return registry.release_of(task, namespace)
    return f"{namespace}:{release}" if namespace and ":" not in release else release


def env_version(registry: Registry, task: str, entries: Sequence[PolicyEntry]) -> int:
    """Return the environment version in which all policies were trained; the newest without any.

    Raises:
        RegistryVersionError: The policies were trained in several versions, or in one that is not
            playable here.
    """
    if not entries:
        return VERSIONS[task]
    first, version = entries[0], registry.env_version(entries[0])
    if version != VERSIONS[task]:
        raise _unfit(registry, first, VERSIONS[task], "as installed")
    for entry in entries:
        if registry.env_version(entry) != version:
            raise _unfit(registry, entry, version, f"as {first.id} was trained")
    return version


def claimed_versions(robots: Roster) -> dict[str, int]:
    """Return the environment versions that robots' files claim, by the robot's id."""
    members = robots.describe(robots.ids)
    return {robot.id: robot.env_version for robot in members if robot.env_version is not None}


def version_of_all(
    registry: Registry, task: str, entries: Sequence[PolicyEntry], claimed: Mapping[str, int]
) -> int:
    """Return the environment version of policies of a registry and robots from files.

    Args:
        registry: The registry of `entries`.
        task: The task whose environment is meant.
        entries: The policies of the registry.
        claimed: The versions that files of robots claim, by robot.

    Raises:
        RegistryVersionError: The versions differ, or the version is not playable here.
    """
    version = env_version(registry, task, entries)
    if claimed and not entries:
        version = next(iter(claimed.values()))
    for robot, its in claimed.items():
        if its == version == VERSIONS[task]:
            continue
        together = f"version {version} of environment {task}, which the others play"
        installed = f"version {VERSIONS[task]} of environment {task}"
        raise RegistryVersionError(
            f"robot {robot}",
            expected=together if version == VERSIONS[task] else f"{installed}, as installed",
            found=f"a file that says that it was trained in version {its}",
            done="nothing was evaluated",
            next_step="choose partners of its version, or train the robot with these partners",
        )
    return version


def _unfit(registry: Registry, entry: PolicyEntry, version: int, why: str) -> RegistryVersionError:
    """Return the error of a policy that was trained in another version; `why` explains it."""
    fitting = []
    for name, release in registry.data.releases.items():
        if release.environments.get(entry.task) == version:
            offers = (source.offered(entry.task, name) for source in registry.sources)
            fitting += [offer for offer in offers if offer]
    return RegistryVersionError(
        f"policy {entry.id}",
        expected=f"version {version} of environment {entry.task}, {why}",
        found=f"release {entry.release}, trained on version {registry.env_version(entry)}",
        done="nothing was evaluated",
        next_step=f"choose other robots, or partners of version {version}: {listing(fitting)}"
        if fitting
        else f"install the assistax-zoo of release {entry.release}",
    )


def entries_of(
    registry: Registry, robots: Roster, humans: Sequence[PolicyEntry], baselines: bool
) -> list[PolicyEntry]:
    """Return the published policies of a study, in registry order.

    With `baselines` these include the robots of the humans' teams.
    """
    teams = {human.team for human in humans} if baselines else set()
    teammates = [e.id for e in registry.policies if e.role == "robot" and e.team in teams]
    return registry.known([*robots.members, *(human.id for human in humans), *teammates])


def roots_of(registry: Registry, entries: Sequence[PolicyEntry]) -> dict[str, str]:
    """Return the root hash of each release of the entries, by release."""
    return {
        release: registry.root(release) for release in sorted({e.release for e in entries} - {""})
    }


def groups_beside_teams(split: Split | None) -> tuple[str, ...]:
    """Return the groups of a test side on which teams stand beside persons; else nothing."""
    kind = described_kind()
    if split is None or split.rule != kind.word or all(map(kind.owns, split.test)):
        return ()
    return KNOWN_FAMILIES, UNSEEN_FAMILY, TEAMS


def sides_of(humans: Sequence[PolicyEntry], split: Split | None) -> dict[str, str]:
    """Return the split's side of each human, by id, without humans on no side."""
    if split is None:
        return {}
    side_of = {team: side for side, teams in split.sides.items() for team in teams}
    return {human.id: side_of[human.team] for human in humans if human.team in side_of}


def own_robots(registry: Registry, partners: Sequence[PolicyEntry]) -> tuple[Roster, Roster] | None:
    """Return the published robots of the partners' teams and, row by row, those partners.

    If no team has a published robot, return None.
    """
    robots = {entry.team: entry for entry in registry.policies if entry.role == "robot"}
    pairs = [(robots[human.team], human) for human in partners if human.team in robots]
    return paired_rosters(registry, pairs) if pairs else None
