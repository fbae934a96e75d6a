"""What is evaluated, as data: policies in groups of one spec, the job, and its plan.

A plan has tiles, which are simulated together, in chunks, which are saved.
"""

import dataclasses
import hashlib
import importlib.metadata
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from assistax_envs.disability import Disability
from population.spec import PolicySpec

MANIFEST_FORMAT = (
    3  # 2: the table has columns of behaviour. 3: tiles, by which values differ in the last bit
)
TILE_ENVS = 512  # most simulations at once on `native`: more are no faster on two cores


@dataclasses.dataclass(frozen=True)
class Member:
    """One policy of a group, with what the episode table says about it."""

    id: str  # registry id, or the reference by which a policy from outside was given
    digest: str  # sha256 of its parameters, or of its source where it is code
    team: str | None = None
    algorithm: str | None = None
    disability: str | None = None
    seed: int | None = None
    setting: Disability | None = None  # what a human's setting is; the installed one of its name
    reusable: bool = True  # False where the digest does not cover all that the policy depends on


@dataclasses.dataclass(frozen=True)
class ReferenceSpec:
    """Sizes of egos that look at nothing: see `evaluation.reference_egos.ReferencePolicy`."""

    observation_size: int
    action_size: int
    role: str = "robot"


@dataclasses.dataclass(frozen=True, eq=False)
class Group:
    """Policies of one spec, their parameters stacked."""

    spec: PolicySpec
    members: tuple[Member, ...]
    params: Mapping[str, Any]  # nested, leaves [G, ...] in the order of `members`


@dataclasses.dataclass(frozen=True, eq=False)
class ReferenceGroup:
    """Egos that look at nothing."""

    spec: ReferenceSpec
    members: tuple[Member, ...]
    params: Mapping[str, Any]  # leaves [G]


@dataclasses.dataclass(frozen=True, eq=False)
class HostEgo:
    """A robot in anybody's framework: a callable from batched observations to batched actions."""

    member: Member
    act: Callable[
        [Any], Any
    ]  # [B, O] float32 NumPy -> [B, A]; `act.reset(B)` is called at episode starts if it exists

    @property
    def members(self) -> tuple[Member, ...]:
        """The one policy of this group."""
        return (self.member,)


Ego = Group | HostEgo | ReferenceGroup


@dataclasses.dataclass(frozen=True, eq=False)
class Job:
    """Every ego with every partner, for a number of episodes."""

    task: str
    env_version: int
    backend: str
    egos: tuple[Ego, ...]
    partners: tuple[Group, ...]
    episodes: int  # K, of each pair
    seed: int = 0  # of the episode seeds
    stochastic: bool = False  # whether actions are drawn; else each policy's mode
    sides: Mapping[str, str] = dataclasses.field(
        default_factory=dict
    )  # partner id -> "train" or "test"
    paired: bool = False  # ego i of group g with partner i of group g, and no other

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(
                f"episodes is {self.episodes}; each pair needs at least 1 (--episodes 8)"
            )
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; allowed is 0 or more")
        for seat, groups in (("ego", self.egos), ("partner", self.partners)):
            ids = [member.id for group in groups for member in group.members]
            if not ids:
                raise ValueError(f"no {seat} to evaluate; give at least one")
            if twice := sorted({name for name in ids if ids.count(name) > 1}):
                raise ValueError(
                    f"{seat} {twice[0]} is given {ids.count(twice[0])} times; give each {seat} once"
                )
        sizes = [[len(group.members) for group in groups] for groups in (self.egos, self.partners)]
        if self.paired and sizes[0] != sizes[1]:
            raise ValueError(
                f"paired egos {sizes[0]} and partners {sizes[1]} differ in number; give them one "
                "to one"
            )
        for group in self.partners:
            for member in group.members:
                if member.disability is None:
                    raise ValueError(
                        f"partner {member.id} has no disability setting; give it one of d1..d9"
                    )

    @property
    def rows(self) -> int:
        """Number of episodes in the whole job."""
        egos = 1 if self.paired else count_members(self.egos)
        return egos * count_members(self.partners) * self.episodes

    def identity(self) -> dict[str, Any]:
        """Return what decides the values of the episode table, JSON-ready."""
        return {
            "format": MANIFEST_FORMAT,
            "task": self.task,
            "env_version": self.env_version,
            "backend": self.backend,
            "episodes": self.episodes,
            "seed": self.seed,
            "stochastic": self.stochastic,
            **({"paired": True} if self.paired else {}),
            "egos": [[member.id, member.digest] for group in self.egos for member in group.members],
            "partners": [
                [member.id, member.disability, self.sides.get(member.id), member.digest]
                for group in self.partners
                for member in group.members
            ],
            "software": {name: importlib.metadata.version(name) for name in ("jax", "mujoco")},
        }

    def digest(self) -> str:
        """Return the sha256 of the job's identity."""
        return hashlib.sha256(json.dumps(self.identity(), sort_keys=True).encode()).hexdigest()


@dataclasses.dataclass(frozen=True)
class Tile:
    """A rectangle of a job: [E egos, P partners, K episodes] simulated together, padded at the job's edge."""

    ego_group: int
    partner_group: int
    egos: range  # real members of the ego group
    partners: range
    episodes: range
    shape: tuple[int, int, int]  # [E, P, K] with padding: equal for all tiles of a pair of groups
    paired: bool = False  # the egos are the partners' own, one each, and E is 1

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        if self.paired:
            return len(self.partners) * len(self.episodes)
        return len(self.egos) * len(self.partners) * len(self.episodes)


@dataclasses.dataclass(frozen=True)
class Chunk:
    """Tiles whose episodes are saved together."""

    index: int  # place in the plan; names the chunk's part
    tiles: tuple[Tile, ...]

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        return sum(tile.rows for tile in self.tiles)


def count_members(groups: tuple[Ego, ...] | tuple[Group, ...]) -> int:
    """Return the number of policies in all groups."""
    return sum(len(group.members) for group in groups)


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


def plan(job: Job, max_envs: int) -> list[Chunk]:
    """Cut a job into tiles, and its tiles into chunks of at most `max_envs` simulations, but a tile at least.

    On `native` the tiles are the job's own, whatever `max_envs` is: an episode is played in the
    same row of the same program however the job is cut, and its values are the same. On other
    backends a chunk is one large tile.
    """
    if max_envs < 1:
        raise ValueError(f"max_envs is {max_envs}; allowed is 1 or more")
    tiles = cut_tiles(job, TILE_ENVS if job.backend == "native" else max_envs)
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
    """Cut a job into tiles of at most `most` simulations, one shape for each pair of groups."""
    tiles: list[Tile] = []
    for i, ego in enumerate(job.egos):
        for j, partner in enumerate(job.partners):
            if job.paired and i != j:
                continue
            sizes = 1 if job.paired else len(ego.members), len(partner.members), job.episodes
            shape = tile_shape(*sizes, most, host=isinstance(ego, HostEgo))
            egos, partners, episodes = (
                _cut(size, width) for size, width in zip(sizes, shape, strict=True)
            )
            if shape == (1, 1, 1) and most > 1:
                shape = (1, 1, 2)  # a batch of one takes other paths, and would round differently
            tiles += [
                Tile(i, j, p if job.paired else e, p, k, shape, job.paired)
                for e in egos
                for p in partners
                for k in episodes
            ]
    return tiles


def _balanced(size: int, most: int) -> int:
    """Return the smallest width that cuts `size` into as few pieces as width `most` does."""
    return math.ceil(size / math.ceil(size / most))


def _cut(size: int, width: int) -> list[range]:
    return [range(start, min(start + width, size)) for start in range(0, size, width)]
