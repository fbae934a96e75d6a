"""Latents of a rollout: the memory's output, which policy and critic then read.

Latents are computed once for a rollout and stay fixed while the robot learns from it, like
observations. So PPO's first ratios are 1, and its gradient does not reach the memory, which the
method trains.
"""

from typing import TYPE_CHECKING, NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn

from population.networks.policy import Gaussian, Policy
from population.networks.seat import Params
from population.networks.unrolled import unroll_memory

if TYPE_CHECKING:
    from population.trainers.experience import Batch


class Latents(NamedTuple):
    """Latents of the observations acted on, at time limits, and after the rollout."""

    acted: jax.Array  # [T, N, Z]
    final: jax.Array  # [N, Z]
    last: jax.Array  # [N, Z]


class TwoLayers(nn.Module):
    """Network of a hidden layer of 64 and a linear output of `width`."""

    width: int

    @nn.compact
    def __call__(self, inputs: jax.Array) -> jax.Array:
        hidden = nn.tanh(nn.Dense(64)(inputs))
        return nn.Dense(self.width)(hidden)


def latents(policy: Policy, params: Params, role: str, batch: "Batch") -> Latents:
    """Return the latents of a role's rollout; a simulation has at most one time limit in it."""
    action = squashed(policy, batch.raw[role])
    given = batch.carry[role], batch.obs[role], batch.first
    states, acted = unroll_memory(policy, params, *given, action)
    after = jnp.concatenate([states, action], axis=-1)
    at_limit = jnp.where(batch.truncated[..., None], after, 0.0).sum(0)
    never = jnp.zeros_like(batch.last_first)
    _, final = policy.recall(params, at_limit, batch.tally.final_obs[role], never)
    _, last = policy.recall(params, after[-1], batch.last_obs[role], batch.last_first)
    return Latents(acted, final, last)


def squashed(policy: Policy, raw: jax.Array) -> jax.Array:
    """Return the actions in [-1, 1] of raw actions [..., A]."""
    return Gaussian(raw, raw, policy.spec.squash).action(raw)
