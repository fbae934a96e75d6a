"""Teams of an audit, from the registry or from folders that `train` filled."""

import dataclasses
import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from assistax_workshop.press.trained_runs import read_run
from evaluation.cast.egos import read_egos
from evaluation.cast.roster import Member, Roster, registry_roster
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack, flatten, stack_policies
from population.runs.folder import RunFolder
from zoo.registry import Registry

Single = tuple[Member, PolicySpec, Any]


@dataclasses.dataclass(frozen=True)
class Row:
    """Policy of one seat of a team."""

    id: str
    spec: PolicySpec
    params: Any


@dataclasses.dataclass(frozen=True)
class Teams:
    """Robots and, unless they are robots alone, their humans; the stacks of both pair up."""

    robots: Roster
    humans: Roster
    met: tuple[str, ...] = ()  # frozen humans that robots alone were trained with

    SEATS: ClassVar = ("robot", "human")

    def rows(self, role: str) -> list[Row]:
        """Return the policies of a seat, team by team."""
        roster = self.robots if role == "robot" else self.humans
        return [
            Row(name, stack.spec, stack.row(place))
            for stack in roster.stacks
            if isinstance(stack, PolicyStack)
            for place, name in enumerate(stack.ids)
        ]


def read_teams(sources: Sequence[str], registry: Registry, task: str) -> Teams:
    """Return the teams of run folders of `train`, and of globs over the registry.

    Raises:
        ValueError: A folder is of another task, or nothing matches.
        ZooError: A folder, or the registry, cannot give them.
    """
    pairs: list[tuple[Single, Single]] = []
    for source in sources:
        teams = _of_run(source, task) if Path(source).is_dir() else _of_zoo(source, registry, task)
        pairs += [(team["robot"], team["human"]) for team in teams if len(team) == 2]
    if not pairs:
        raise ValueError(f"no team of {task} in {', '.join(sources)}; give a folder of `train`")
    by_specs: dict[Any, list[tuple[Single, Single]]] = {}
    for robot, human in pairs:
        by_specs.setdefault((robot[1], human[1]), []).append((robot, human))
    ordered = [pair for alike in by_specs.values() for pair in alike]
    stacks: tuple[list[PolicyStack], list[PolicyStack]] = ([], [])
    for alike in by_specs.values():
        for seat, stack in enumerate(stacks):
            stack += stack_policies((m.id, spec, params) for m, spec, params in
                                  (pair[seat] for pair in alike))  # fmt: skip
    robots, humans = (
        Roster(tuple(stacks[seat]), {pair[seat][0].id: pair[seat][0] for pair in ordered})
        for seat in range(2)
    )
    return Teams(robots, humans)


def read_robots(sources: Sequence[str], registry: Registry, task: str) -> Teams:
    """Return robots alone, from folders of `train` or by any form of a robot."""
    single: list[Single] = []
    other: list[str] = []
    for source in sources:
        if Path(source).is_dir():
            single += [team["robot"] for team in _of_run(source, task)]
        else:
            other.append(source)
    members = {member.id: member for member, _, _ in single}
    stacks: tuple[Any, ...] = stack_policies((m.id, spec, params) for m, spec, params in single)
    if other:
        named = read_egos(other, registry, task)
        stacks, members = (*stacks, *named.stacks), members | dict(named.members)
    return Teams(Roster(stacks, members), Roster((), {}))


def read_trained_egos(sources: Sequence[str], registry: Registry, task: str) -> Teams:
    """Return robots from folders of `train`, with the frozen humans that they were trained with."""
    if elsewhere := [source for source in sources if not Path(source).is_dir()]:
        raise ValueError(f"an ego is {elsewhere[0]!r}; give the folder in which it was trained")
    met = [name for source in sources for name in RunFolder(source).config().partners]
    return dataclasses.replace(read_robots(sources, registry, task), met=tuple(met))


def _of_run(source: str, task: str) -> list[dict[str, Single]]:
    """Return the teams of a run folder, by role."""
    teams: list[dict[str, Single]] = []
    for team in read_run(source):
        if team.task != task:
            raise ValueError(f"{source} is of task {team.task}; give teams of {task}")
        name = f"{Path(source).resolve().name}/{team.algorithm}-{team.disability}-s{team.seed}"
        teams.append(
            {
                role: (
                    Member(
                        f"{name}/{role}",
                        _digest(params),
                        name,
                        team.algorithm,
                        team.disability,
                        team.seed,
                    ),
                    team.specs[role],
                    params,
                )
                for role, params in team.params.items()
            }
        )
    return teams


def _of_zoo(pattern: str, registry: Registry, task: str) -> list[dict[str, Single]]:
    """Return the registry's teams of a pattern, by role."""
    teams: dict[str, dict[str, Single]] = {}
    for role in Teams.SEATS:
        entries = registry.select(pattern, task=task, role=role)
        roster = registry_roster(registry, entries)
        for stack in roster.stacks:
            assert isinstance(stack, PolicyStack)
            for place, name in enumerate(stack.ids):
                member = roster.members[name]
                teams.setdefault(str(member.team), {})[role] = (
                    member,
                    stack.spec,
                    stack.row(place),
                )
    return list(teams.values())


def _digest(params: Any) -> str:
    """Return the sha256 of nested parameters."""
    whole = hashlib.sha256()
    for name, leaf in sorted(flatten(params).items()):
        whole.update(name.encode() + np.ascontiguousarray(leaf).tobytes())
    return whole.hexdigest()
