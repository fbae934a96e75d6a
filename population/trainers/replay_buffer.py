"""Replay buffer of the newest transitions of every member, in a ring on the device.

A slot of the ring is a rollout of T steps in a member's n simulations. Observations are stored
once, as T + 2 rows: the T acted on, the one after them, and the one at a simulation's time limit
before its reset, of which a rollout has one at most. The successor of a transition is one of these
rows, so that values at time limits come from the state that was reached.

Memory of one member, in floats: capacity x ((T + 2) / T x widths of the observations read + widths
of the actions + 1). With a million transitions, T = 8 and the task scratch that is 0.41 GB for
local critics (34 + 38) and 0.67 GB for central ones (and 52 more): 32 members take 13 and 21 GB.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from population.trainers.experience import Batch


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Replay:
    """Rollouts of all members in C slots."""

    obs: dict[str, jax.Array]  # by name [M, C, T + 2, n, O]
    action: dict[str, jax.Array]  # in [-1, 1], by role [M, C, T, n, A]
    reward: jax.Array  # [M, C, T, n]
    terminated: jax.Array  # [M, C, T, n]
    truncated: jax.Array  # [M, C, T, n]
    rollouts: jax.Array  # rollouts written so far []


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Transitions:
    """Steps drawn from a replay; leaves [..., B] and [..., B, width]."""

    obs: dict[str, jax.Array]
    next_obs: dict[str, jax.Array]  # before any reset
    action: dict[str, jax.Array]
    reward: jax.Array
    terminated: jax.Array


def empty(
    members: int,
    slots: int,
    steps: int,
    simulations: int,
    observations: dict[str, int],
    actions: dict[str, int],
) -> Replay:
    """Return an empty replay of C slots, each of T steps of n simulations."""
    shape = (members, slots, steps, simulations)
    rows = (members, slots, steps + 2, simulations)
    return Replay(
        obs={name: jnp.zeros((*rows, width)) for name, width in observations.items()},
        action={role: jnp.zeros((*shape, width)) for role, width in actions.items()},
        reward=jnp.zeros(shape),
        terminated=jnp.zeros(shape, bool),
        truncated=jnp.zeros(shape, bool),
        rollouts=jnp.zeros((), jnp.int32),
    )


def add(replay: Replay, batch: Batch, action: dict[str, jax.Array]) -> Replay:
    """Return the replay with a rollout in place of the oldest.

    Its leaves are [M, T, n, ...].
    """
    slot = replay.rollouts % replay.reward.shape[1]

    def write(ring: jax.Array, rollout: jax.Array) -> jax.Array:
        return jax.lax.dynamic_update_index_in_dim(ring, rollout, slot, axis=1)

    final_obs = batch.tally.final_obs
    rows = {
        name: jnp.concatenate(
            [batch.obs[name], batch.last_obs[name][:, None], final_obs[name][:, None]], axis=1
        )
        for name in replay.obs
    }
    return Replay(
        obs=jax.tree.map(write, replay.obs, rows),
        action=jax.tree.map(write, replay.action, action),
        reward=write(replay.reward, batch.reward),
        terminated=write(replay.terminated, batch.terminated),
        truncated=write(replay.truncated, batch.truncated),
        rollouts=replay.rollouts + 1,
    )


def draw(replay: Replay, keys: jax.Array, shape: tuple[int, ...]) -> Transitions:
    """Return transitions drawn uniformly with replacement: leaves [M, *shape, ...] for keys [M]."""
    members, slots, steps, simulations = replay.reward.shape
    filled = jnp.minimum(replay.rollouts, slots) * (steps * simulations)
    index = jax.vmap(lambda key: jax.random.randint(key, shape, 0, filled))(keys)
    slot, rest = index // (steps * simulations), index % (steps * simulations)
    time, simulation = rest // simulations, rest % simulations
    member = jnp.arange(members).reshape(-1, *(1 for _ in shape))

    def take(leaf: jax.Array, time: jax.Array) -> Any:
        return leaf.at[member, slot, time, simulation].get(mode="promise_in_bounds")

    successor = jnp.where(take(replay.truncated, time), steps + 1, time + 1)
    return Transitions(
        obs=jax.tree.map(lambda leaf: take(leaf, time), replay.obs),
        next_obs=jax.tree.map(lambda leaf: take(leaf, successor), replay.obs),
        action=jax.tree.map(lambda leaf: take(leaf, time), replay.action),
        reward=take(replay.reward, time),
        terminated=take(replay.terminated, time),
    )
