"""Cut a job into tiles, which are simulated together, and chunks of tiles, which are saved."""

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Sequence
from typing import Any

from evaluation.cast.roster import Roster
from evaluation.play.jobs import Job

# Most simulations in a tile, on the backends whose tiles do not depend on `max_envs`. More are not
# faster on two cores.
TILE_ENVS = {"native": 512, "fused": 32768}
# On `fused` on GPUs a launch waits for its slowest simulation, so larger tiles wait less often.
GPU_TILE_ENVS = 98304
# A smaller job is one tile of all its networks. With several programs, compilation and starting
# each step would take most of the time.
SMALL_JOB = 8192


@dataclasses.dataclass(frozen=True)
class StackSlice:
    """A tile's policies of one stack."""

    stack: int
    rows: range  # rows of the stack, without padding
    width: int  # number of rows with padding, which repeats the last row


@dataclasses.dataclass(frozen=True)
class Tile:
    """A part of a job that is simulated together: [E egos, P partners, K episodes], padded.

    It has a slice of one ego stack and one partner stack, or all stacks of a small job.
    """

    egos: tuple[StackSlice, ...]
    partners: tuple[StackSlice, ...]
    episodes: range
    at_once: int  # K with padding; the number of series if episodes are played in series
    paired: bool = False  # one ego for each partner, and E is 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """The sizes [E, P, K] with padding."""
        e, p = (sum(cut.width for cut in seat) for seat in (self.egos, self.partners))
        return 1 if self.paired else e, p, self.at_once

    @property
    def rows(self) -> int:
        """Number of episodes, without padding."""
        return math.prod(self.played)

    @property
    def played(self) -> tuple[int, int, int]:
        """The sizes [E, P, episodes] without padding."""
        e, p = (sum(len(cut.rows) for cut in seat) for seat in (self.egos, self.partners))
        return 1 if self.paired else e, p, len(self.episodes)

    @property
    def program(self) -> Any:
        """Key that is equal for tiles of a job with the same compiled program."""
        slices = (*self.egos, *self.partners)
        return tuple((cut.stack, cut.width) for cut in slices), self.at_once


@dataclasses.dataclass(frozen=True)
class Chunk:
    """Tiles whose episodes are saved together."""

    index: int  # place in the plan
    tiles: tuple[Tile, ...]

    @property
    def name(self) -> str:
        """The start of its part's file name, which differs for other cuts of the job."""
        cut = hashlib.sha256(repr(self.tiles).encode()).hexdigest()
        return f"part-{self.index:05d}-{cut[:8]}"

    @property
    def rows(self) -> int:
        """Number of episodes, without padding."""
        return sum(tile.rows for tile in self.tiles)


def tile_shape(
    egos: int, partners: int, episodes: int, most: int, *, host: bool = False
) -> tuple[int, int, int]:
    """Return a tile's sizes [E, P, K] with E * P * K <= most.

    They minimise the work, which is the padded simulations and a fixed cost for each tile. Among
    equals the squarest is chosen, which reads the fewest parameters for each simulation. Episodes
    are split only if one pair's do not fit.
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
    """Return the largest number of simulations in a tile on this machine.

    On `native` and `fused` it does not depend on `max_envs`. So an episode is always played in the
    same row of the same program and its values are the same. On other backends a chunk is one large
    tile.
    """
    # Imported here, because making or reading a job does not need it.
    import jax

    if backend == "fused" and jax.default_backend() == "gpu":
        return GPU_TILE_ENVS
    return TILE_ENVS.get(backend, max_envs)


def plan(job: Job, max_envs: int, most: int | None = None) -> list[Chunk]:
    """Return a job's chunks: tiles of up to `max_envs` simulations together, at least one tile.

    `most` is the largest number of simulations in a tile; by default that of `tile_envs`.
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
    """Return a job's tiles of at most `most` simulations, of one shape for each pair of stacks.

    A small job is one tile of all its stacks, or one of those that bring their preferences and one
    of the others.
    """
    rounds = job.episodes // job.series
    egos, partners = _whole_stacks(job.egos), _whole_stacks(job.partners)
    if _is_small(job, most):
        return [_small(job, egos, some, most) for some in _by_preferences(job, partners)]
    tiles: list[Tile] = []
    for ego, partner in itertools.product(egos, partners):
        if job.paired and ego.stack != partner.stack:
            continue
        sizes = 1 if job.paired else ego.width, partner.width, rounds
        host = job.egos.host(ego.stack) is not None
        e, p, k = tile_shape(*sizes, most, host=host)
        cuts = [_cut(size, width) for size, width in zip(sizes, (e, p, k), strict=True)]
        for some, others, turns in itertools.product(*cuts):
            humans = StackSlice(partner.stack, others, p)
            robots = humans if job.paired else StackSlice(ego.stack, some, e)
            episodes = range(turns.start * job.series, turns.stop * job.series)
            at_once = _at_once(k, e * p * k, most)
            tiles.append(Tile((robots,), (humans,), episodes, at_once, job.paired))
    return tiles


def _by_preferences(job: Job, partners: Sequence[StackSlice]) -> list[list[StackSlice]]:
    """Return the partners that draw preferences, and those that bring them, without empty lists."""
    stacks = job.partners.stacks
    own = [not job.partners.with_own.isdisjoint(stacks[cut.stack].ids) for cut in partners]
    both = (
        [cut for cut, its in zip(partners, own, strict=True) if its is of] for of in (False, True)
    )
    return [some for some in both if some]


def _small(job: Job, egos: Sequence[StackSlice], partners: Sequence[StackSlice], most: int) -> Tile:
    """Return the tile of all egos, or of the partners' own in pairs, with some partners."""
    places = {cut.stack for cut in partners}
    robots = [cut for cut in egos if cut.stack in places] if job.paired else egos
    tile = Tile(tuple(robots), tuple(partners), range(job.episodes), 1, job.paired)
    at_once = _at_once(job.episodes // job.series, tile.rows // job.series, most)
    return dataclasses.replace(tile, at_once=at_once)


def _whole_stacks(roster: Roster) -> list[StackSlice]:
    sizes = [len(stack.ids) for stack in roster.stacks]
    return [StackSlice(place, range(size), size) for place, size in enumerate(sizes)]


def _is_small(job: Job, most: int) -> bool:
    """Return whether a job is one tile. A robot from outside shares no tile with other robots."""
    alone = len(job.egos.stacks) == 1
    return (alone or not job.egos.hosts) and job.rows // job.series <= min(most, SMALL_JOB)


def _at_once(episodes: int, simulations: int, most: int) -> int:
    """Return K of a tile, at least 2 in a batch of one, which would be rounded differently."""
    return 2 if simulations == 1 and most > 1 else episodes


def _balanced(size: int, most: int) -> int:
    """Return the smallest width that cuts `size` into as few pieces as width `most` does."""
    return math.ceil(size / math.ceil(size / most))


def _cut(size: int, width: int) -> list[range]:
    return [range(start, min(start + width, size)) for start in range(0, size, width)]
