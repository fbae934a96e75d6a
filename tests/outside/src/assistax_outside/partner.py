"""A kind of partner: humans that rest, each weaker than the one before."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from assistax_base.digest import sha256
from assistax_envs.disability import Disability
from assistax_envs.registered import REGISTERED
from assistax_envs.versions import VERSIONS
from population.networks.seat import SeatSizes
from population.networks.stack import PolicyStack
from zoo.ids import compile_pattern
from zoo.partners.source import PartnerSource, made_entry
from zoo.schema import PolicyEntry, Split
from zoo.splits import made_split

COUNT = 4  # humans of a task; the first half trains robots


@dataclasses.dataclass(frozen=True)
class RestingSpec(SeatSizes):
    """Spec of humans that apply no torque."""

    def player(self) -> "RestingPlayer":
        """Return the player of all resting humans."""
        return RestingPlayer(self.action_size)


class RestingPlayer:
    """Plays resting humans."""

    def __init__(self, action_size: int) -> None:
        self._action_size = action_size

    def initial_carry(self, batch_shape: tuple[int, ...]) -> tuple[()]:
        """Return the empty carry."""
        return ()

    def act(self, params: Any, carry: Any, obs: Any, first: Any) -> tuple[Any, Any]:
        """Return the carry and torques of 0, [..., A]."""
        import jax.numpy as jnp

        return carry, jnp.zeros((*obs.shape[:-1], self._action_size), obs.dtype)


class Resting(PartnerSource):
    """Humans that rest, with strengths from 1 down to a quarter."""

    word = "resting"

    @classmethod
    def owns(cls, name: str) -> bool:
        """Return whether an id or a glob names resting humans."""
        return "/resting-" in name

    def select(self, patterns: Sequence[str]) -> list[PolicyEntry]:
        """Return the entries whose id or team matches one of the globs."""
        matches = [compile_pattern(pattern).match for pattern in patterns]
        return [e for e in self._entries() if any(m(e.id) or m(e.team) for m in matches)]

    def split(self, task: str, name: str | None, release: str | None = None) -> Split | None:
        """Return the split of a task's resting humans; None for names of other kinds."""
        if name is None or self.word not in name:
            return None
        teams = [entry.team for entry in self._entries([task])]
        half = COUNT // 2
        return made_split(self.word, task, self._release(task), teams[:half], teams[half:])

    def stacks(self, entries: Sequence[PolicyEntry]) -> tuple[PolicyStack[Any], ...]:
        """Return a stack for each task, in the order of the entries."""
        by_spec: dict[Any, list[str]] = {}
        for entry in entries:
            by_spec.setdefault(entry.spec, []).append(entry.id)
        return tuple(
            PolicyStack(spec, tuple(ids), {"none": np.zeros((len(ids), 1), np.float32)})
            for spec, ids in by_spec.items()
        )

    def _release(self, task: str) -> str:
        return self.registry.release_of(task)

    def _entries(self, tasks: Iterable[str] = ("gentle_wave",)) -> Iterator[PolicyEntry]:
        """Yield the entries of the resting humans of tasks."""
        for task in tasks:
            person = REGISTERED[task].person
            assert person is not None
            spec: Any = RestingSpec("human", *person.seat_size)
            for number in range(COUNT):
                team = f"{task}/resting-{number}-{self._release(task)}"
                yield made_entry(
                    spec,
                    task,
                    team,
                    algorithm=self.word,
                    number=number,
                    digest=sha256(f"resting 1 {team}".encode()),
                    env_version=VERSIONS[task],
                    setting=Disability(1.0 - number / COUNT, 1.0, 0.0),
                    release=self._release(task),
                )
