"""The job of an evaluation, as data; `evaluation.play.tiles` cuts it into tiles."""

import dataclasses
import hashlib
import importlib.metadata
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int, Shaped

from evaluation.cast.roster import Member, Roster
from evaluation.figures.metrics.installed import InstalledMetric
from evaluation.play.how import check_numbers
from evaluation.record.alike import COLUMNS
from evaluation.record.manifest import identity_digest
from population.views import View
from zoo.partners.person_ids import OWN

if TYPE_CHECKING:
    from population.play.tally import Column

# Raise it if the same job would give other tables. 2: columns of behaviour. 3: tiles, which change
# the last bit of values. 4: disability settings by value, and the engine. 5: policies of several
# networks in one tile. 6: intervals of partners' means include new starts.
EVALUATOR_VERSION = 6


@dataclasses.dataclass(frozen=True, eq=False)
class Job:
    """Every ego with every partner, for a number of episodes."""

    task: str
    env_version: int
    backend: str
    egos: Roster
    partners: Roster
    episodes: int  # K, of each pair
    seed: int = 0  # from which episode seeds are made
    stochastic: bool = False  # whether actions are drawn; else each policy's mode
    # Partner id -> "train" or "test".
    sides: Mapping[str, str] = dataclasses.field(default_factory=dict)
    paired: bool = False  # ego i of stack g plays only with partner i of stack g
    series: int = 1  # number of consecutive episodes in which a robot remembers its partner
    own_episodes: bool = False  # whether each partner has its own episode seeds, see `seeds`
    engine: Mapping[str, str] = dataclasses.field(default_factory=dict)  # name and version
    view: View = View.PLAIN  # the robots' observations
    scene: str | None = None  # sha256 of the task's scene; None for an environment from outside
    # Of the gentle tasks: what partners without their own preferences like, in turns, see
    # `preferences_of`; empty where it is drawn.
    preferences: tuple[str, ...] = ()
    # Side -> preferences of its partners, if the sides differ.
    side_preferences: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    # Of installed packages, whose columns the episodes have.
    metrics: Mapping[str, InstalledMetric] = dataclasses.field(default_factory=dict)

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
        if self.partners.own_preferences and self.preferences:
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
    def rows(self) -> int:
        """Number of episodes in the whole job."""
        egos = 1 if self.paired else len(self.egos.ids)
        return egos * len(self.partners.ids) * self.episodes

    @property
    def columns(self) -> "dict[str, Column]":
        """The columns that metrics of installed packages add, by the metric's name."""
        metrics = {name: installed.metric for name, installed in self.metrics.items()}
        return {name: metric.column for name, metric in metrics.items() if metric.column}

    @property
    def reusable(self) -> bool:
        """Whether the identity covers all that the table depends on."""
        return all(self.egos.members[name].reusable for name in self.egos.ids)

    def identity(self) -> dict[str, Any]:
        """Return all that decides the values of the episode table, ready for JSON.

        Unused optional fields are omitted, so older digests stay valid.
        """
        optional = {
            "preferences": list(self.preferences),
            "side_preferences": {
                side: list(names) for side, names in self.side_preferences.items()
            },
            "series": self.series if self.series > 1 else None,
            "scene": self.scene,
            COLUMNS: {name: self.metrics[name].source for name in self.columns},
        }
        return {name: value for name, value in optional.items() if value} | {
            "evaluator_version": EVALUATOR_VERSION,
            "task": self.task,
            "env_version": self.env_version,
            "backend": self.backend,
            "engine": self.view.engine(self.engine),
            "episodes": self.episodes,
            "seed": self.seed,
            "stochastic": self.stochastic,
            "paired": self.paired,
            # The name in the folders of all versions.
            "apart": self.own_episodes,
            "egos": [[name, self.egos.members[name].digest] for name in self.egos.ids],
            "partners": [
                [
                    human.id,
                    human.disability,
                    self.sides.get(human.id),
                    human.digest,
                    _setting(human),
                ]
                for human in self.partners.describe(self.partners.ids)
            ],
            "software": {name: importlib.metadata.version(name) for name in ("jax", "mujoco")},
        }

    def digest(self) -> str:
        """Return the sha256 of the job's identity."""
        return identity_digest(self.identity())

    def seeds(self, partners: Sequence[str], episodes: Sequence[int]) -> Int[np.ndarray, "*P K"]:
        """Return the seeds of episodes: [K] common to all partners, or [P, K] if each has its own.

        With own seeds, the starts of different partners are independent. A mean over partners then
        varies as little as one of independent episodes, and resampled partners bring their starts
        along. All egos meet a partner in the same episodes. In series, seeds are in the order of
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
        """Return the index of the episode that is played at each place, [P, K], in whole series.

        Partners begin their series with different episodes, so each place is played from every
        start. A return that grows from place to place is then not an effect of the starts.
        """
        place = np.arange(episodes)
        first = np.array([_stable_hash(name) for name in partners])[:, None]
        return place // self.series * self.series + (place + first) % self.series

    def preferences_of(
        self, partners: Sequence[str], episodes: Sequence[int]
    ) -> Shaped[np.ndarray, "P K"]:
        """Return the names of the preferences under which partners play episodes, [P, K].

        The preferences take turns over a partner's episodes, as in a Latin square. A partner's id
        decides its first one. So every start is played under several preferences, all preferences
        are about equally frequent, and a partner's do not depend on the other partners. Within a
        series a partner keeps its preference. A partner that brings its own has `OWN`.
        """
        rows = []
        for name in partners:
            if name in self.partners.with_own:
                rows.append([OWN] * len(episodes))
                continue
            names = self.side_preferences.get(self.sides.get(name, ""), self.preferences)
            turns = [_stable_hash(name) + episode // self.series for episode in episodes]
            rows.append([names[turn % len(names)] for turn in turns])
        return np.array(rows)

    def with_side_preferences(self, preferences: Mapping[str, tuple[str, ...]]) -> "Job":
        """Return the job with each partner under the preferences of its side of a split.

        A partner on no side, such as the passive human, plays under those of all sides that play.
        """
        played = {side: preferences[side] for side in sorted(set(self.sides.values()))}
        names = tuple(sorted({name for side in played.values() for name in side}))
        differing = played if len(played) > 1 else {}
        return dataclasses.replace(self, preferences=names, side_preferences=differing)


def episode_seeds(seed: int, episodes: Iterable[int], partner: str | None = None) -> list[int]:
    """Return one seed for each episode number, for one partner, or common to all if it is None.

    A seed depends on its episode's number only, so a longer run begins with a shorter run's seeds.
    """
    entropy = [] if partner is None else [_stable_hash(partner)]
    sequences = (np.random.SeedSequence([seed, k, *entropy]) for k in episodes)
    return [int(sequence.generate_state(1)[0]) for sequence in sequences]


def _stable_hash(partner: str) -> int:
    """Return a 32-bit hash of a partner's id, the same in every process."""
    return int.from_bytes(hashlib.sha256(partner.encode()).digest()[:4])


def _setting(member: Member) -> list[float] | None:
    """Return the numbers of a member's disability setting, or None if it has only a name."""
    return None if member.setting is None else list(dataclasses.astuple(member.setting))
