"""Who plays in a seat: stacks of policies and robots from outside, each described by its id."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_envs.disability import Disability
from assistax_envs.preferences import Told
from evaluation.cast.robot_forms import as_robot
from population.networks.seat import Seat
from population.networks.stack import PolicyStack
from zoo.met.published import NOT_KNOWN, Met, met_in_training
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry
from zoo.schema import PolicyEntry


@dataclasses.dataclass(frozen=True)
class Member:
    """What the episode table and a job's identity say about one policy."""

    id: str  # registry id, or the reference by which a policy from outside was given
    digest: str  # sha256 of its parameters, or of its source where it is code
    team: str | None = None
    algorithm: str | None = None
    disability: str | None = None
    seed: int | None = None
    setting: Disability | None = None  # what a human's setting is; the installed one of its name
    reusable: bool = True  # False where the digest does not cover all that the policy depends on
    # Outside any registry, that the digest is of; each with its sha256 as it was read.
    files: tuple[tuple[Path, str], ...] = ()
    met: Met = NOT_KNOWN  # whom a robot met in training; no part of a job's identity
    # Of the environment, in which a robot's file says that it was trained; None if it does not say.
    env_version: int | None = None
    told: Told = False  # what it observes that no robot may: a row to compare with


@dataclasses.dataclass(frozen=True, eq=False)
class HostEgo:
    """A robot in anybody's framework: a callable from batched observations to batched actions."""

    id: str
    act: Any  # of any form; from then on a `Robot`: [B, O] float32 NumPy -> [B, A]
    # The files of its code that ran until now, with their sha256; code may load more as it plays.
    loaded: Callable[[], Mapping[Path, str]] = dict
    made_of: Any = None  # equal for copies of one robot, whatever they are called

    def __post_init__(self) -> None:
        object.__setattr__(self, "act", as_robot(self.act))

    @property
    def ids(self) -> tuple[str, ...]:
        """The one policy of this ego, as a stack has several."""
        return (self.id,)


@dataclasses.dataclass(frozen=True, eq=False)
class Roster:
    """The policies of one seat of a job, in the order in which the table has them."""

    stacks: tuple[PolicyStack | HostEgo, ...]
    members: Mapping[str, Member]  # by id

    @property
    def ids(self) -> tuple[str, ...]:
        """All policies, stack by stack."""
        return tuple(name for stack in self.stacks for name in stack.ids)

    @property
    def hosts(self) -> tuple[HostEgo, ...]:
        """The robots from outside."""
        return tuple(stack for stack in self.stacks if isinstance(stack, HostEgo))

    def host(self, place: int) -> HostEgo | None:
        """Return the robot from outside in a place of `stacks`, None where policies are."""
        stack = self.stacks[place]
        return stack if isinstance(stack, HostEgo) else None

    @property
    def told(self) -> Told:
        """What its robots observe that no robot may.

        Raises:
            ValueError: Some do and some do not.
        """
        told = {self.members[name].told for name in self.ids}
        if len(told) > 1:
            names = [name for name in self.ids if self.members[name].told]
            raise ValueError(
                f"{names[0]} is told what humans like and other robots are not, or less; play them "
                "apart"
            )
        return told.pop() if told else False

    @property
    def policies(self) -> tuple[PolicyStack, ...]:
        """The stacks of networks: all of a roster that has no robot from outside."""
        return tuple(stack for stack in self.stacks if isinstance(stack, PolicyStack))

    def describe(self, ids: Sequence[str]) -> list[Member]:
        """Return the descriptions of policies in this order."""
        return [self.members[name] for name in ids]


def check_seat(name: str, spec: Seat, role: str, env: Any, task: str) -> None:
    """Refuse a policy whose seat, observations or actions are not those of a task's role."""
    if spec.role != role:
        raise ValueError(
            f"{name} plays the {spec.role}, not the {role}; give it as the {spec.role}"
        )
    for what, width, expected in (
        ("reads observations of", spec.observation_size, env.observation_size[role]),
        ("gives actions of", spec.action_size, env.action_size[role]),
    ):
        if width != expected:
            raise ValueError(
                f"{name} {what} {width} numbers; the {role} of task {task} has {expected}: it was "
                "made for another task, choose a policy of this one (`assistax-zoo list`)"
            )


def registry_roster(registry: Registry, entries: Sequence[PolicyEntry]) -> Roster:
    """Load policies of the registry, hashes checked."""
    members = {
        entry.id: Member(
            id=entry.id,
            digest=entry.sha256,
            team=entry.team,
            algorithm=entry.algorithm,
            disability=entry.disability if entry.setting else None,  # an ego has no human
            seed=entry.seed,
            setting=entry.setting,
            met=met_in_training(registry, entry) if entry.role == "robot" else NOT_KNOWN,
        )
        for entry in entries
    }
    return Roster(load_stacks(registry, entries), members)


def paired_rosters(
    registry: Registry, pairs: Sequence[tuple[PolicyEntry, PolicyEntry]]
) -> tuple[Roster, Roster]:
    """Load robots beside humans, row by row: one stack on either side for each pair of specs."""
    by_specs: dict[Any, list[tuple[PolicyEntry, PolicyEntry]]] = {}
    for robot, human in pairs:
        by_specs.setdefault((robot.spec, human.spec), []).append((robot, human))
    robots, humans = (
        [registry_roster(registry, [pair[seat] for pair in alike]) for alike in by_specs.values()]
        for seat in (0, 1)
    )
    return joined(*robots), joined(*humans)


def joined(*rosters: Roster) -> Roster:
    """Return the policies of several rosters as one seat's, stack by stack."""
    members = {name: member for roster in rosters for name, member in roster.members.items()}
    return Roster(tuple(stack for roster in rosters for stack in roster.stacks), members)
