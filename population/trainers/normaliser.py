"""Running mean and variance of observations."""

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from population.networks.seat import Params

_VARIANCE_FLOOR = 1e-6  # keeps a constant feature finite


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Statistics:
    """Mean [O] and variance [O] of the `count` observations seen so far."""

    count: jax.Array
    mean: jax.Array
    variance: jax.Array


def empty(size: int) -> Statistics:
    """Return initial statistics, an identity that the first batch replaces."""
    return Statistics(jnp.zeros(()), jnp.zeros(size), jnp.ones(size))


def update(statistics: Statistics, obs: Float[Array, "*batch O"]) -> Statistics:
    """Return the statistics merged with obs [..., O] (parallel variance of Chan et al., 1979)."""
    flat = obs.reshape(-1, obs.shape[-1])
    count = statistics.count + flat.shape[0]
    share = flat.shape[0] / count
    mean = flat.mean(0)
    variance = jnp.square(flat - mean[None]).mean(0)
    delta = mean - statistics.mean
    return Statistics(
        count=count,
        mean=statistics.mean + share * delta,
        variance=(1.0 - share) * statistics.variance
        + share * variance
        + share * (1.0 - share) * jnp.square(delta),
    )


def to_params(statistics: Statistics) -> Params:
    """Return the "normaliser" of a policy's parameters."""
    return {"mean": statistics.mean, "std": jnp.sqrt(statistics.variance + _VARIANCE_FLOOR)}
