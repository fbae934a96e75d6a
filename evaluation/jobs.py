"""What is evaluated, as data: policies in groups of one spec, the job, and its plan of equal chunks."""

import dataclasses
import hashlib
import importlib.metadata
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

from population.spec import PolicySpec

MANIFEST_FORMAT = 2  # 2: the table has columns of behaviour


@dataclasses.dataclass(frozen=True)
class Member:
    """One policy of a group, with what the episode table says about it."""

    id: str  # registry id, or the reference by which a policy from outside was given
    digest: str  # sha256 of its parameters, or of its source where it is code
    team: str | None = None
    algorithm: str | None = None
    disability: str | None = None
    seed: int | None = None


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
    act: Callable[[Any], Any]  # [B, O] float32 NumPy -> [B, A]; `act.reset(B)` is called at episode starts if it exists

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
    sides: Mapping[str, str] = dataclasses.field(default_factory=dict)  # partner id -> "train" or "test"
    paired: bool = False  # ego i of group g with partner i of group g, and no other

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ValueError(f"episodes is {self.episodes}; each pair needs at least 1 (--episodes 8)")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; allowed is 0 or more")
        for seat, groups in (("ego", self.egos), ("partner", self.partners)):
            ids = [member.id for group in groups for member in group.members]
            if not ids:
                raise ValueError(f"no {seat} to evaluate; give at least one")
            if twice := sorted({name for name in ids if ids.count(name) > 1}):
                raise ValueError(f"{seat} {twice[0]} is given {ids.count(twice[0])} times; give each {seat} once")
        sizes = [[len(group.members) for group in groups] for groups in (self.egos, self.partners)]
        if self.paired and sizes[0] != sizes[1]:
            raise ValueError(f"paired egos {sizes[0]} and partners {sizes[1]} differ in number; give them one to one")
        for group in self.partners:
            for member in group.members:
                if member.disability is None:
                    raise ValueError(f"partner {member.id} has no disability setting; give it one of d1..d9")

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
class Chunk:
    """A rectangle of a job: [E egos, P partners, K episodes] simulated together, padded at the job's edge."""

    index: int  # place in the plan; names the chunk's part
    ego_group: int
    partner_group: int
    egos: range  # real members of the ego group
    partners: range
    episodes: range
    shape: tuple[int, int, int]  # [E, P, K] with padding: equal for all chunks of a pair of groups
    paired: bool = False  # the egos are the partners' own, one each, and E is 1

    @property
    def rows(self) -> int:
        """Number of episodes, padding not counted."""
        if self.paired:
            return len(self.partners) * len(self.episodes)
        return len(self.egos) * len(self.partners) * len(self.episodes)


def count_members(groups: tuple[Ego, ...] | tuple[Group, ...]) -> int:
    """Return the number of policies in all groups."""
    return sum(len(group.members) for group in groups)


def chunk_shape(egos: int, partners: int, episodes: int, max_envs: int, *, host: bool = False) -> tuple[int, int, int]:
    """Choose [E, P, K] with E * P * K <= max_envs.

    Least work first, counting padded simulations and a fixed cost for each chunk; then the squarest, which reads the
    fewest parameters for each simulation. Episodes are only split where one pair's do not fit.
    """
    if max_envs < 1:
        raise ValueError(f"max_envs is {max_envs}; allowed is 1 or more")
    k = _balanced(episodes, max_envs)
    pairs = max(1, max_envs // k)

    def cost(shape: tuple[int, int]) -> tuple[int, int]:
        e, p = shape
        chunks = math.ceil(egos / e) * math.ceil(partners / p)
        return chunks * (e * p * k + max_envs // 4), e + p

    widths = {_balanced(egos, width) for width in range(1, (1 if host else min(egos, pairs)) + 1)}
    e, p = min(((e, _balanced(partners, pairs // e)) for e in sorted(widths)), key=cost)
    return e, p, k


def plan(job: Job, max_envs: int) -> list[Chunk]:
    """Cut a job into chunks of at most `max_envs` simulations, one shape for each pair of groups."""
    if job.paired:
        return _plan_pairs(job, max_envs)
    chunks: list[Chunk] = []
    for i, ego in enumerate(job.egos):
        for j, partner in enumerate(job.partners):
            sizes = len(ego.members), len(partner.members), job.episodes
            shape = chunk_shape(*sizes, max_envs, host=isinstance(ego, HostEgo))
            slices = [_cut(size, width) for size, width in zip(sizes, shape, strict=True)]
            chunks += [
                Chunk(0, i, j, egos, partners, episodes, shape)
                for egos in slices[0]
                for partners in slices[1]
                for episodes in slices[2]
            ]
    return [dataclasses.replace(chunk, index=index) for index, chunk in enumerate(chunks)]


def _plan_pairs(job: Job, max_envs: int) -> list[Chunk]:
    chunks: list[Chunk] = []
    for i, partner in enumerate(job.partners):
        _, p, k = shape = chunk_shape(1, len(partner.members), job.episodes, max_envs)
        chunks += [
            Chunk(0, i, i, rows, rows, episodes, shape, paired=True)
            for rows in _cut(len(partner.members), p)
            for episodes in _cut(job.episodes, k)
        ]
    return [dataclasses.replace(chunk, index=index) for index, chunk in enumerate(chunks)]


def _balanced(size: int, most: int) -> int:
    """Return the smallest width that cuts `size` into as few pieces as width `most` does."""
    return math.ceil(size / math.ceil(size / most))


def _cut(size: int, width: int) -> list[range]:
    return [range(start, min(start + width, size)) for start in range(0, size, width)]
