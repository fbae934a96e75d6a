"""Rosters: the policies of one seat, as stacks and robots from outside, described by id."""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_envs.disability import Disability
from evaluation.cast.robot_forms import as_robot
from population.networks.seat import Seat
from population.networks.stack import PolicyStack
from population.views import View
from zoo.met.published import NOT_KNOWN, Met, met_in_training
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry
from zoo.schema import PolicyEntry


@dataclasses.dataclass(frozen=True)
class Member:
    """Description of one policy, for the episode table and for a job's identity."""

    id: str  # registry id, or the reference of a policy from outside
    digest: str  # sha256 of its parameters, or of its source if it is code
    team: str | None = None
    algorithm: str | None = None
    disability: str | None = None
    seed: int | None = None
    setting: Disability | None = None  # a human's disability setting, as values
    reusable: bool = True  # False if the policy depends on more than the digest covers
    # Files outside any registry that the digest covers, each with its sha256 when it was read.
    files: tuple[tuple[Path, str], ...] = ()
    met: Met = NOT_KNOWN  # a robot's training partners; no part of a job's identity
    # The environment version that a robot's file claims; None if it claims none.
    env_version: int | None = None
    view: View = View.PLAIN  # a robot's observations


@dataclasses.dataclass(frozen=True, eq=False)
class HostEgo:
    """A robot in any framework: a callable from batched observations to batched actions."""

    id: str
    act: Any  # given in any accepted form, stored as a `Robot`: [B, O] float32 NumPy -> [B, A]
    # Returns the files of its code that ran until now, with their sha256.
    loaded: Callable[[], Mapping[Path, str]] = dict
    made_of: Any = None  # equal for copies of one robot under different ids

    def __post_init__(self) -> None:
        object.__setattr__(self, "act", as_robot(self.act))

    @property
    def ids(self) -> tuple[str, ...]:
        """The id of this ego, as a tuple like a stack's ids."""
        return (self.id,)


@dataclasses.dataclass(frozen=True, eq=False)
class Roster:
    """The policies of one seat of a job, in the order of the episode table."""

    stacks: tuple[PolicyStack | HostEgo, ...]
    members: Mapping[str, Member]  # by id

    @property
    def ids(self) -> tuple[str, ...]:
        """The ids of all policies, stack by stack."""
        return tuple(name for stack in self.stacks for name in stack.ids)

    @property
    def hosts(self) -> tuple[HostEgo, ...]:
        """The robots from outside."""
        return tuple(stack for stack in self.stacks if isinstance(stack, HostEgo))

    def host(self, place: int) -> HostEgo | None:
        """Return the robot from outside at `stacks[place]`, or None if it is a policy stack."""
        stack = self.stacks[place]
        return stack if isinstance(stack, HostEgo) else None

    @property
    def view(self) -> View:
        """The observations of its robots.

        Raises:
            ValueError: Some do and some do not.
        """
        views = {self.members[name].view for name in self.ids}
        if len(views) > 1:
            names = [name for name in self.ids if self.members[name].view is not View.PLAIN]
            raise ValueError(
                f"{names[0]} observes secrets of the humans, and other robots observe fewer; play "
                "them apart"
            )
        return views.pop() if views else View.PLAIN

    @property
    def own_preferences(self) -> bool:
        """Whether all its humans bring preferences and bodies of their own."""
        bring = {stack.spec.own_preferences for stack in self.policies}
        return bring == {True}

    @functools.cached_property
    def with_own(self) -> frozenset[str]:
        """The ids of its humans that bring preferences of their own."""
        own = (stack.ids for stack in self.policies if stack.spec.own_preferences)
        return frozenset(name for ids in own for name in ids)

    @property
    def policies(self) -> tuple[PolicyStack, ...]:
        """The stacks of networks, without robots from outside."""
        return tuple(stack for stack in self.stacks if isinstance(stack, PolicyStack))

    def describe(self, ids: Sequence[str]) -> list[Member]:
        """Return the descriptions of these policies, in this order."""
        return [self.members[name] for name in ids]


def check_seat(name: str, spec: Seat, role: str, env: Any, task: str) -> None:
    """Raise a ValueError if a policy does not fit the role, observations or actions of a task."""
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
    """Return the roster of policies of the registry, loaded with their hashes checked."""
    members = {
        entry.id: Member(
            id=entry.id,
            digest=entry.sha256,
            team=entry.team,
            algorithm=entry.algorithm,
            # An ego trained with frozen partners has no human of its own.
            disability=entry.disability if entry.setting else None,
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
    """Return the rosters of the robots and the humans of pairs: row i of each is a pair.

    Pairs with equal specs share a stack on either side.
    """
    by_specs: dict[Any, list[tuple[PolicyEntry, PolicyEntry]]] = {}
    for robot, human in pairs:
        by_specs.setdefault((robot.spec, human.spec), []).append((robot, human))
    robots, humans = (
        [registry_roster(registry, [pair[seat] for pair in alike]) for alike in by_specs.values()]
        for seat in (0, 1)
    )
    return joined(*robots), joined(*humans)


def joined(*rosters: Roster) -> Roster:
    """Return one roster with the policies of several, stack by stack."""
    members = {name: member for roster in rosters for name, member in roster.members.items()}
    return Roster(tuple(stack for roster in rosters for stack in roster.stacks), members)
