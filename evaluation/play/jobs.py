"""The job of an evaluation, as data. `evaluation.play.tiles` cuts it."""

import dataclasses
import hashlib
import importlib.metadata
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int, Shaped

from evaluation.cast.roster import Member, Roster
from evaluation.play.how import check_numbers
from evaluation.record.manifest import identity_digest

# Goes up when the same job would give other tables. 2: columns of behaviour. 3: tiles, by which
# values differ in the last bit. 4: disability settings by value, and the engine. 5: policies of
# several networks in one tile. 6: the intervals of partners' means are of new starts too.
EVALUATOR_VERSION = 6
TOLD_PARTNER = "told-partner"  # the engine's condition: robots observe their person's numbers


@dataclasses.dataclass(frozen=True, eq=False)
class Job:
    """Every ego with every partner, for a number of episodes."""

    task: str
    env_version: int
    backend: str
    egos: Roster
    partners: Roster
    episodes: int  # K, of each pair
    seed: int = 0  # of the episode seeds
    stochastic: bool = False  # whether actions are drawn; else each policy's mode
    # Partner id -> "train" or "test".
    sides: Mapping[str, str] = dataclasses.field(default_factory=dict)
    paired: bool = False  # ego i of stack g with partner i of stack g, and no other
    series: int = 1  # episodes in which a robot remembers a partner, one after the other
    own_episodes: bool = False  # each partner's are its own, not those of all: see `seeds`
    engine: Mapping[str, str] = dataclasses.field(default_factory=dict)  # name and version
    scene: str | None = None  # sha256 of the task's scene; None of an environment from outside
    # Of the gentle tasks: what the partners like, in turns, see `preferences_of`; empty where it is
    # drawn.
    preferences: tuple[str, ...] = ()
    # Side -> those of its partners, where the sides differ.
    side_preferences: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        check_numbers(self.episodes, self.seed, self.series)
        for seat, roster in (("ego", self.egos), ("partner", self.partners)):
            ids = roster.ids
            if not ids:
                raise ValueError(f"no {seat} to evaluate; give at least one")
            if twice := sorted({name for name in ids if ids.count(name) > 1}):
                raise ValueError(
                    f"{seat} {twice[0]} is given {ids.count(twice[0])} times; give each {seat} once"
                )
        sizes = [[len(stack.ids) for stack in seat.stacks] for seat in (self.egos, self.partners)]
        if self.paired and sizes[0] != sizes[1]:
            raise ValueError(
                f"paired egos {sizes[0]} and partners {sizes[1]} differ in number; give them one "
                "to one"
            )
        if self.own_wishes and self.preferences:
            raise ValueError(
                f"preferences are {', '.join(self.preferences)}, but persons have their own "
                "preferences; leave preferences out"
            )
        for member in self.partners.describe(self.partners.ids):
            if member.disability is None:
                raise ValueError(
                    f"partner {member.id} has no disability setting; give it one of d1..d9"
                )

    @property
    def own_wishes(self) -> bool:
        """Whether the partners bring wishes of their own, as persons do.

        Raises:
            ValueError: Some do, and some do not.
        """
        return brings_wishes(self.partners)

    @property
    def rows(self) -> int:
        """Number of episodes in the whole job."""
        egos = 1 if self.paired else len(self.egos.ids)
        return egos * len(self.partners.ids) * self.episodes

    @property
    def reusable(self) -> bool:
        """Whether the identity covers all that the table depends on.

        A finished one is the answer.
        """
        return all(self.egos.members[name].reusable for name in self.egos.ids)

    def identity(self) -> dict[str, Any]:
        """Return what decides the values of the episode table, JSON-ready."""
        optional = {  # only where used
            "preferences": list(self.preferences),
            "side_preferences": {
                side: list(names) for side, names in self.side_preferences.items()
            },
            "series": self.series if self.series > 1 else None,
            "scene": self.scene,
        }
        return {name: value for name, value in optional.items() if value} | {
            "evaluator_version": EVALUATOR_VERSION,
            "task": self.task,
            "env_version": self.env_version,
            "backend": self.backend,
            "engine": dict(self.engine),
            "episodes": self.episodes,
            "seed": self.seed,
            "stochastic": self.stochastic,
            "paired": self.paired,
            "apart": self.own_episodes,  # as folders of all versions call it
            "egos": [[name, self.egos.members[name].digest] for name in self.egos.ids],
            "partners": [
                [who.id, who.disability, self.sides.get(who.id), who.digest, _setting(who)]
                for who in self.partners.describe(self.partners.ids)
            ],
            "software": {name: importlib.metadata.version(name) for name in ("jax", "mujoco")},
        }

    def digest(self) -> str:
        """Return the sha256 of the job's identity."""
        return identity_digest(self.identity())

    def seeds(self, partners: Sequence[str], episodes: Sequence[int]) -> Int[np.ndarray, "*P K"]:
        """Return the seeds of episodes, [K] for all partners, or [P, K] where each has its own.

        With its own, a partner's luck is its own too: a mean over partners then varies as little as
        that of as many independent episodes, and partners that are resampled bring their starts
        along. All egos meet a partner in the same episodes. In series they are in the order of
        play.
        """
        if self.own_episodes:
            seeds = np.array([episode_seeds(self.seed, episodes, name) for name in partners])
        else:
            seeds = np.array(episode_seeds(self.seed, episodes))
        if self.series == 1:
            return seeds
        order = self.order(partners, len(episodes))
        return np.take_along_axis(np.broadcast_to(seeds, order.shape), order, axis=1)

    def order(self, partners: Sequence[str], episodes: int) -> Int[np.ndarray, "P K"]:
        """Return which of whole series of episodes is played in each place, [P, K].

        Another partner begins its series with another episode: over partners each place is played
        from every start, and a return that grows from place to place is not the starts' luck.
        """
        place = np.arange(episodes)
        first = np.array([_number(name) for name in partners])[:, None]
        return place // self.series * self.series + (place + first) % self.series

    def preferences_of(
        self, partners: Sequence[str], episodes: Sequence[int]
    ) -> Shaped[np.ndarray, "P K"]:
        """Return the names of the preferences under which partners play episodes, [P, K].

        The preferences take turns over a partner's episodes, as in a Latin square: another partner
        begins with another, which its id decides. So every start is played under several, few
        episodes of many partners have all of them equally often, and no partner's depend on who
        else plays. Within a series a partner is one person, and likes one thing.
        """
        rows = []
        for name in partners:
            names = self.side_preferences.get(self.sides.get(name, ""), self.preferences)
            turns = [_number(name) + episode // self.series for episode in episodes]
            rows.append([names[turn % len(names)] for turn in turns])
        return np.array(rows)

    def with_side_preferences(self, preferences: Mapping[str, tuple[str, ...]]) -> "Job":
        """Return the job with each partner under the preferences of its side of a split.

        Who is on no side, as the passive human, plays under those of all sides that play.
        """
        played = {side: preferences[side] for side in sorted(set(self.sides.values()))}
        names = tuple(sorted({name for side in played.values() for name in side}))
        differing = played if len(played) > 1 else {}
        return dataclasses.replace(self, preferences=names, side_preferences=differing)


def brings_wishes(humans: Roster) -> bool:
    """Return whether humans bring wishes and bodies of their own, as persons do.

    Raises:
        ValueError: Some do, and some do not.
    """
    bring = {hasattr(stack.spec, "humans") for stack in humans.policies}
    if len(bring) > 1:
        raise ValueError(
            "some partners are persons, which have their own preferences, and others are not; "
            "play them in separate jobs"
        )
    return True in bring


def episode_seeds(seed: int, episodes: Iterable[int], partner: str | None = None) -> list[int]:
    """Return the seeds of episodes k, independent of how many there are: more extend fewer.

    They are a partner's own, or common to all where none is named.
    """
    own = [] if partner is None else [_number(partner)]
    sequences = (np.random.SeedSequence([seed, k, *own]) for k in episodes)
    return [int(sequence.generate_state(1)[0]) for sequence in sequences]


def _number(partner: str) -> int:
    """Return a number of a partner's own, whoever else plays."""
    return int.from_bytes(hashlib.sha256(partner.encode()).digest()[:4])


def _setting(member: Member) -> list[float] | None:
    """Return the numbers of a partner's disability setting, where they came with it."""
    return None if member.setting is None else list(dataclasses.astuple(member.setting))
