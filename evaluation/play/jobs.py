"""What is evaluated, as data: the job, and its plan.

A plan has tiles, which are simulated together, in chunks, which are saved.
"""

import dataclasses
import hashlib
import importlib.metadata
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from assistax_envs.preferences import preferences_of
from evaluation.cast.roster import HostEgo, Member, Roster
from evaluation.record.manifest import identity_digest

# Goes up when the same job would give other tables. 2: columns of behaviour. 3: tiles, by which
# values differ in the last bit. 4: disability settings by value, and the engine. 5: policies of
# several networks in one tile. 6: the intervals of partners' means are of new starts too.
EVALUATOR_VERSION = 6
# Most simulations at once, on the backends whose tiles are the job's own: on `native` more are no
# faster on two cores; on `fused` two cores do not care either.
TILE_ENVS = {"native": 512, "fused": 32768}
# On `fused` on GPUs: a launch waits for its slowest simulation, of which more then wait together.
GPU_TILE_ENVS = 98304
# A job of so few is one tile, whatever its policies' networks are: what each program costs, its
# compilation and the start of every step, would be most of the time.
SMALL_JOB = 8192


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
    apart: bool = False  # each partner plays episodes of its own, not those of all: see `seeds`
    engine: Mapping[str, str] = dataclasses.field(default_factory=dict)  # name and version
    # Of the gentle tasks: what the partners like, in turns, see `wishes`; empty where it is drawn.
    preferences: tuple[str, ...] = ()
    # Side -> those of its partners, where the sides differ.
    side_preferences: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; each pair needs at least 1")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; allowed is 0 or more")
        if self.series < 1 or self.episodes % self.series:
            raise ValueError(
                f"series is {self.series} of {self.episodes} episodes; give 1 or more, and a "
                "multiple of it as episodes (--series 5 --episodes 10)"
            )
        for seat, roster in (("ego", self.egos), ("partner", self.partners)):
            ids = roster.ids
            if not ids:
                raise ValueError(f"no {seat} to evaluate; give at least one")
            if twice := sorted({name for name in ids if ids.count(name) > 1}):
                raise ValueError(
                    f"{seat} {twice[0]} is given {ids.count(twice[0])} times; give each {seat} once"
                )
        sizes = [[len(one.ids) for one in seat.stacks] for seat in (self.egos, self.partners)]
        if self.paired and sizes[0] != sizes[1]:
            raise ValueError(
                f"paired egos {sizes[0]} and partners {sizes[1]} differ in number; give them one "
                "to one"
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
    def reusable(self) -> bool:
        """Whether the identity covers all that the table depends on.

        A finished one is the answer.
        """
        return all(self.egos.members[name].reusable for name in self.egos.ids)

    def identity(self) -> dict[str, Any]:
        """Return what decides the values of the episode table, JSON-ready."""
        newer = {  # told where used, so that folders of before there were any stay the answer
            "preferences": list(self.preferences),
            "side_preferences": {side: list(own) for side, own in self.side_preferences.items()},
            "series": self.series if self.series > 1 else None,
        }
        return {name: value for name, value in newer.items() if value} | {
            "evaluator_version": EVALUATOR_VERSION,
            "task": self.task,
            "env_version": self.env_version,
            "backend": self.backend,
            "engine": dict(self.engine),
            "episodes": self.episodes,
            "seed": self.seed,
            "stochastic": self.stochastic,
            "paired": self.paired,
            "apart": self.apart,
            "egos": [[name, self.egos.members[name].digest] for name in self.egos.ids],
            "partners": [
                [one.id, one.disability, self.sides.get(one.id), one.digest, _setting(one)]
                for one in self.partners.describe(self.partners.ids)
            ],
            "software": {name: importlib.metadata.version(name) for name in ("jax", "mujoco")},
        }

    def digest(self) -> str:
        """Return the sha256 of the job's identity."""
        return identity_digest(self.identity())

    def seeds(self, partners: Sequence[str], episodes: Sequence[int]) -> np.ndarray:
        """Return the seeds of episodes, [K] for all partners, or [P, K] where each has its own.

        With its own, a partner's luck is its own too: a mean over partners then varies as little as
        that of as many independent episodes, and partners that are resampled bring their starts
        along. All egos meet a partner in the same episodes. In series they are in the order of
        play.
        """
        if self.apart:
            seeds = np.array([episode_seeds(self.seed, episodes, name) for name in partners])
        else:
            seeds = np.array(episode_seeds(self.seed, episodes))
        if self.series == 1:
            return seeds
        order = self.order(partners, len(episodes))
        return np.take_along_axis(np.broadcast_to(seeds, order.shape), order, axis=1)

    def order(self, partners: Sequence[str], episodes: int) -> np.ndarray:
        """Return which of whole series of episodes is played in each place, [P, K].

        Another partner begins its series with another episode: over partners each place is played
        from every start, and a return that grows from place to place is not the starts' luck.
        """
        place = np.arange(episodes)
        first = np.array([_number(name) for name in partners])[:, None]
        return place // self.series * self.series + (place + first) % self.series

    def wishes(self, partners: Sequence[str], episodes: Sequence[int]) -> np.ndarray:
        """Return the names of the preferences under which partners play episodes, [P, K].

        The preferences take turns over a partner's episodes, as in a Latin square: another partner
        begins with another, which its id decides. So every start is played under several, few
        episodes of many partners have all of them equally often, and no partner's depend on who
        else plays. Within a series a partner is one person, and likes one thing.
        """
        rows = []
        for name in partners:
            likes = self.side_preferences.get(self.sides.get(name, ""), self.preferences)
            turns = [_number(name) + episode // self.series for episode in episodes]
            rows.append([likes[turn % len(likes)] for turn in turns])
        return np.array(rows)

    def following(self, preferences: Mapping[str, tuple[str, ...]]) -> "Job":
        """Return the job with each partner under the preferences of its side of a split.

        Who is on no side, as the passive human, plays under those of all sides that play.
        """
        played = {side: preferences[side] for side in sorted(set(self.sides.values()))}
        likes = tuple(sorted({name for names in played.values() for name in names}))
        differing = played if len(played) > 1 else {}
        return dataclasses.replace(self, preferences=likes, side_preferences=differing)


@dataclasses.dataclass(frozen=True)
class Share:
    """Which policies of a stack are in a tile."""

    stack: int
    rows: range  # padding not counted
    width: int  # with padding, in which the last is repeated


@dataclasses.dataclass(frozen=True)
class Tile:
    """A rectangle of a job, simulated together: [E egos, P partners, K episodes], edges padded.

    It has a share of one ego stack and of one partner stack, or small jobs whole.
    """

    egos: tuple[Share, ...]
    partners: tuple[Share, ...]
    episodes: range
    at_once: int  # K with padding; that of the series where there are any
    paired: bool = False  # the egos are the partners' own, one each, and E is 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return [E, P, K] with padding."""
        e, p = (sum(share.width for share in seat) for seat in (self.egos, self.partners))
        return 1 if self.paired else e, p, self.at_once

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        return math.prod(self.played)

    @property
    def played(self) -> tuple[int, int, int]:
        """Return [E, P, episodes] without padding."""
        e, p = (sum(len(share.rows) for share in seat) for seat in (self.egos, self.partners))
        return 1 if self.paired else e, p, len(self.episodes)

    @property
    def program(self) -> Any:
        """Return what tiles of a job have in common that are played by the same program."""
        shares = (*self.egos, *self.partners)
        return tuple((share.stack, share.width) for share in shares), self.at_once


@dataclasses.dataclass(frozen=True)
class Chunk:
    """Tiles whose episodes are saved together."""

    index: int  # place in the plan
    tiles: tuple[Tile, ...]

    @property
    def name(self) -> str:
        """Return what its part's name begins with: no part of another cut has it."""
        return f"part-{self.index:05d}-{hashlib.sha256(repr(self.tiles).encode()).hexdigest()[:8]}"

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        return sum(tile.rows for tile in self.tiles)


def default_episodes(task: str, series: int = 1) -> int:
    """Return how many episodes a pair plays if nothing else is asked for: whole series.

    Where the partner's preferences take turns, every partner likes each of them equally often.
    """
    turns = 2 * len(preferences_of(task)) or 8
    return math.ceil(turns / series) * series


def episode_seeds(seed: int, episodes: Iterable[int], partner: str | None = None) -> list[int]:
    """Return the seeds of episodes k, independent of how many there are: more extend fewer.

    They are a partner's own, or common to all where none is named.
    """
    own = [] if partner is None else [_number(partner)]
    sequences = (np.random.SeedSequence([seed, k, *own]) for k in episodes)
    return [int(sequence.generate_state(1)[0]) for sequence in sequences]


def tile_shape(
    egos: int, partners: int, episodes: int, most: int, *, host: bool = False
) -> tuple[int, int, int]:
    """Choose [E, P, K] with E * P * K <= most.

    Least work first, counting padded simulations and a fixed cost for each tile; then the squarest,
    which reads the fewest parameters for each simulation. Episodes are only split where one pair's
    do not fit.
    """
    k = _balanced(episodes, most)
    pairs = max(1, most // k)

    def cost(shape: tuple[int, int]) -> tuple[int, int]:
        e, p = shape
        tiles = math.ceil(egos / e) * math.ceil(partners / p)
        return tiles * (e * p * k + most // 4), e + p

    widths = {_balanced(egos, width) for width in range(1, (1 if host else min(egos, pairs)) + 1)}
    e, p = min(((e, _balanced(partners, pairs // e)) for e in sorted(widths)), key=cost)
    return e, p, k


def tile_envs(backend: str, max_envs: int) -> int:
    """Return the most simulations of a tile on this machine.

    On `native` and `fused` that is the same whatever `max_envs` is: an episode is played in the
    same row of the same program however the job is cut, and its values are the same. On other
    backends a chunk is one large tile.
    """
    import jax  # not by who only makes or reads a job

    if backend == "fused" and jax.default_backend() == "gpu":
        return GPU_TILE_ENVS
    return TILE_ENVS.get(backend, max_envs)


def plan(job: Job, max_envs: int, most: int | None = None) -> list[Chunk]:
    """Cut a job into tiles, and its tiles into chunks of `max_envs` simulations or one tile.

    `most` is how many simulations a tile may have; if not given, what `tile_envs` says.
    """
    most = tile_envs(job.backend, max_envs) if most is None else most
    for name, value in (("max_envs", max_envs), ("tile_envs", most)):
        if value < 1:
            raise ValueError(f"{name} is {value}; allowed is 1 or more")
    tiles = cut_tiles(job, most)
    chunks: list[list[Tile]] = []
    room = 0
    for tile in tiles:
        if math.prod(tile.shape) > room:
            chunks.append([])
            room = max_envs
        chunks[-1].append(tile)
        room -= math.prod(tile.shape)
    return [Chunk(index, tuple(tiles)) for index, tiles in enumerate(chunks)]


def cut_tiles(job: Job, most: int) -> list[Tile]:
    """Cut a job into tiles of at most `most` simulations, one shape for each pair of stacks.

    A small job is one tile of all its stacks.
    """
    rounds = job.episodes // job.series
    egos, partners = (
        [Share(i, range(len(stack.ids)), len(stack.ids)) for i, stack in enumerate(seat.stacks)]
        for seat in (job.egos, job.partners)
    )
    if _is_small(job, most):
        at_once = _at_once(rounds, job.rows // job.series, most)
        return [Tile(tuple(egos), tuple(partners), range(job.episodes), at_once, job.paired)]
    tiles: list[Tile] = []
    for ego, partner in itertools.product(egos, partners):
        if job.paired and ego.stack != partner.stack:
            continue
        sizes = 1 if job.paired else ego.width, partner.width, rounds
        host = isinstance(job.egos.stacks[ego.stack], HostEgo)
        e, p, k = tile_shape(*sizes, most, host=host)
        cuts = [_cut(size, width) for size, width in zip(sizes, (e, p, k), strict=True)]
        for some, others, turns in itertools.product(*cuts):
            robots = Share(ego.stack, others, p) if job.paired else Share(ego.stack, some, e)
            humans = Share(partner.stack, others, p)
            episodes = range(turns.start * job.series, turns.stop * job.series)
            at_once = _at_once(k, e * p * k, most)
            tiles.append(Tile((robots,), (humans,), episodes, at_once, job.paired))
    return tiles


def _is_small(job: Job, most: int) -> bool:
    """Return whether a job is one tile; a robot from outside shares none with other robots."""
    hosts = any(isinstance(stack, HostEgo) for stack in job.egos.stacks)
    alone = len(job.egos.stacks) == 1
    return (alone or not hosts) and job.rows // job.series <= min(most, SMALL_JOB)


def _at_once(episodes: int, simulations: int, most: int) -> int:
    """Return K of a tile: a batch of one takes other paths, and would round differently."""
    return 2 if simulations == 1 and most > 1 else episodes


def _number(partner: str) -> int:
    """Return a number of a partner's own, whoever else plays."""
    return int.from_bytes(hashlib.sha256(partner.encode()).digest()[:4])


def _balanced(size: int, most: int) -> int:
    """Return the smallest width that cuts `size` into as few pieces as width `most` does."""
    return math.ceil(size / math.ceil(size / most))


def _cut(size: int, width: int) -> list[range]:
    return [range(start, min(start + width, size)) for start in range(0, size, width)]


def _setting(member: Member) -> list[float] | None:
    """Return the numbers of a partner's disability setting, where they came with it."""
    return None if member.setting is None else list(dataclasses.astuple(member.setting))
