"""How a job is cut: into tiles, which are simulated together, in chunks, which are saved."""

import dataclasses
import hashlib
import itertools
import math
from typing import Any

from evaluation.cast.roster import Roster
from evaluation.play.jobs import Job

# Most simulations at once, on the backends whose tiles are the job's own: on `native` more are no
# faster on two cores; on `fused` two cores do not care either.
TILE_ENVS = {"native": 512, "fused": 32768}
# On `fused` on GPUs: a launch waits for its slowest simulation, of which more then wait together.
GPU_TILE_ENVS = 98304
# A job of so few is one tile, whatever its policies' networks are: what each program costs, its
# compilation and the start of every step, would be most of the time.
SMALL_JOB = 8192


@dataclasses.dataclass(frozen=True)
class StackSlice:
    """Policies of a stack that are in a tile."""

    stack: int
    rows: range  # padding not counted
    width: int  # with padding, in which the last is repeated


@dataclasses.dataclass(frozen=True)
class Tile:
    """A rectangle of a job, simulated together: [E egos, P partners, K episodes], edges padded.

    It has a slice of one ego stack and of one partner stack, or small jobs whole.
    """

    egos: tuple[StackSlice, ...]
    partners: tuple[StackSlice, ...]
    episodes: range
    at_once: int  # K with padding; that of the series where there are any
    paired: bool = False  # the egos are the partners' own, one each, and E is 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return [E, P, K] with padding."""
        e, p = (sum(cut.width for cut in seat) for seat in (self.egos, self.partners))
        return 1 if self.paired else e, p, self.at_once

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        return math.prod(self.played)

    @property
    def played(self) -> tuple[int, int, int]:
        """Return [E, P, episodes] without padding."""
        e, p = (sum(len(cut.rows) for cut in seat) for seat in (self.egos, self.partners))
        return 1 if self.paired else e, p, len(self.episodes)

    @property
    def program(self) -> Any:
        """Return what tiles of a job have in common that are played by the same program."""
        slices = (*self.egos, *self.partners)
        return tuple((cut.stack, cut.width) for cut in slices), self.at_once


@dataclasses.dataclass(frozen=True)
class Chunk:
    """Tiles whose episodes are saved together."""

    index: int  # place in the plan
    tiles: tuple[Tile, ...]

    @property
    def name(self) -> str:
        """Return what its part's name begins with: no part of another cut has it."""
        cut = hashlib.sha256(repr(self.tiles).encode()).hexdigest()
        return f"part-{self.index:05d}-{cut[:8]}"

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        return sum(tile.rows for tile in self.tiles)


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
    egos, partners = _whole_stacks(job.egos), _whole_stacks(job.partners)
    if _is_small(job, most):
        at_once = _at_once(rounds, job.rows // job.series, most)
        return [Tile(tuple(egos), tuple(partners), range(job.episodes), at_once, job.paired)]
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


def _whole_stacks(roster: Roster) -> list[StackSlice]:
    sizes = [len(stack.ids) for stack in roster.stacks]
    return [StackSlice(place, range(size), size) for place, size in enumerate(sizes)]


def _is_small(job: Job, most: int) -> bool:
    """Return whether a job is one tile; a robot from outside shares none with other robots."""
    alone = len(job.egos.stacks) == 1
    return (alone or not job.egos.hosts) and job.rows // job.series <= min(most, SMALL_JOB)


def _at_once(episodes: int, simulations: int, most: int) -> int:
    """Return K of a tile: a batch of one takes other paths, and would round differently."""
    return 2 if simulations == 1 and most > 1 else episodes


def _balanced(size: int, most: int) -> int:
    """Return the smallest width that cuts `size` into as few pieces as width `most` does."""
    return math.ceil(size / math.ceil(size / most))


def _cut(size: int, width: int) -> list[range]:
    return [range(start, min(start + width, size)) for start in range(0, size, width)]
