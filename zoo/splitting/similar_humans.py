"""Partners that act alike: leakage between the sides of a split that no hash can see.

Two humans of one network are compared by the mean absolute difference of their deterministic
actions over fixed probes: observations drawn around the population's own normalisers, played in
short sequences so that recurrent policies show their memory.

`THRESHOLD` follows from the scratch teams of release v0. The 496 pairs of 32 humans differ by 0.29
(the closest) to 0.98, 0.56 in the median. A copy in half precision differs by at most 0.002, a copy
with 1 % of noise in every weight by 0.01, with 10 % by 0.06. So 0.1 lies above the differences of
copies, and three times below those of trainings from two seeds. Further training of a copy may move
it above 0.1: humans below the threshold are copies, humans above it may be related.

In release v1 the closest of a task differ by 0.21 on scratch, 0.18 on bed bath and 0.095 on arm
assist. There two pairs of MAPPO's humans are below the threshold without being copies, because the
task asks little of them. They may share a side.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from assistax_base.errors import LeakageError, listing
from population.networks.stack import PolicyStack
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry
from zoo.schema import Split

THRESHOLD = 0.1
_SEQUENCES, _STEPS = 32, 8  # 256 probes
_SEED = 0


class Pair(NamedTuple):
    """Two teams whose humans act nearly alike."""

    train: str  # on the side that stands before the other's: train, validation, test
    test: str
    difference: float  # mean absolute difference of their actions, each in [-1, 1]

    def __str__(self) -> str:
        return f"{self.train} ~ {self.test} ({self.difference:.3f})"


def similar_pairs(registry: Registry, split: Split, threshold: float = THRESHOLD) -> list[Pair]:
    """Return the pairs of humans across a split's sides that act alike, closest first.

    Imports JAX, and reads the shards.

    Raises:
        IntegrityError: A shard is missing or damaged.
    """
    teams = {team for side in split.sides.values() for team in side}
    humans = [entry for entry in registry.policies if entry.role == "human" and entry.team in teams]
    pairs: list[Pair] = []
    for group in load_stacks(registry, humans):
        names = [policy.rpartition("/")[0] for policy in group.ids]
        sides = [[i for i, n in enumerate(names) if n in side] for side in split.sides.values()]
        if sum(map(bool, sides)) < 2:
            continue
        distances = differences(probe_actions(group))
        for before, after in itertools.combinations(sides, 2):
            pairs += [
                Pair(names[before[i]], names[after[j]], float(distances[before[i], after[j]]))
                for i, j in np.argwhere(distances[np.ix_(before, after)] < threshold)
            ]
    return sorted(pairs, key=lambda pair: pair.difference)


def probe_actions(group: PolicyStack) -> np.ndarray:
    """Return the deterministic actions [P, T, B, A] of a group's policies on the fixed probes."""
    import jax
    import jax.numpy as jnp

    from assistax_envs.own_settings import own_settings
    from population.networks.policy import Policy
    from population.networks.unrolled import unroll_policy

    policy, obs = Policy(group.spec), probes(group)
    first = np.zeros(obs.shape[:2], bool)
    first[0] = True

    def play(params: dict) -> jax.Array:
        carry = policy.initial_carry((_SEQUENCES,))
        chunk = jnp.asarray(obs), jnp.asarray(first)
        return unroll_policy(policy, params, carry, *chunk)[1].mode()

    with own_settings():
        return np.asarray(jax.jit(lambda params: jax.lax.map(play, params))(group.params))


def probes(group: PolicyStack) -> np.ndarray:
    """Return observations [T, B, O]: fixed draws at the median scale of the normalisers."""
    size = group.spec.observation_size
    draws = np.random.default_rng(_SEED).standard_normal((_STEPS, _SEQUENCES, size))
    if group.spec.normalise:
        scale = {
            name: np.median(value, axis=0) for name, value in group.params["normaliser"].items()
        }
        draws = scale["mean"] + scale["std"] * draws
    return draws.astype(np.float32)


def differences(actions: np.ndarray) -> np.ndarray:
    """Return the mean absolute difference [P, P] between policies' actions [P, ...]."""
    flat = actions.reshape(len(actions), -1)
    return np.stack([np.abs(flat - row).mean(axis=1) for row in flat])


def similar_leak(split: str, pairs: Sequence[Pair]) -> LeakageError:
    """Return the error for humans on both sides that act nearly alike."""
    return LeakageError(
        f"split {split} leaks",
        f"humans whose actions differ by {THRESHOLD} or more across its sides",
        f"{len(pairs)} nearly alike: {listing(map(str, pairs), 3)}",
        "put both of a pair on one side, or leave one out, by the rule `custom`",
    )
