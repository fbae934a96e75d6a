"""What makes the teams of a population differ: the bonus of MEP.

Maximum Entropy Population-based training (Zhao et al., 2023, "Maximum Entropy Population-Based
Training for Zero-Shot Human-AI Coordination") pays a team for doing what its population seldom
does.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from population.config import Member, populations
from population.networks.members import member_map
from population.networks.policy import Policy
from population.networks.seat import Params

if TYPE_CHECKING:
    from population.trainers.experience import Batch

# Partners of the zoo are the humans. A robot has joints to spare, in which it could differ from
# other robots without any human noticing.
ROLE = "human"


def peers(members: Sequence[Member]) -> Int[Array, "M n"]:
    """Return for each member the places of all members of its population, its own among them."""
    places = populations(members)
    return jnp.asarray([next(row for row in places if m in row) for m in range(len(members))])


def log_mean_density(
    policy: Policy, params: Params, peers: Int[Array, "M n"], batch: "Batch"
) -> Float[Array, "M T N"]:
    """Return log (1/n) sum_j pi_j(a | o): how usual its population finds what a human did.

    Args:
        policy: The humans' network, which keeps no state.
        params: Parameters of all members, leaves [M, ...].
        peers: As `peers` returns them.
        batch: What the members did, leaves [M, T, N, ...].
    """

    def usual(peers: jax.Array, obs: jax.Array, first: jax.Array, raw: jax.Array) -> jax.Array:
        def density(peer: jax.Array) -> jax.Array:
            own = jax.tree.map(lambda leaf: leaf[peer], params)
            return policy.step(own, (), obs, first)[1].log_prob(raw)

        # In turn: the activations of one network at a time are in memory.
        densities = jax.lax.map(density, peers)
        return jax.nn.logsumexp(densities, axis=0) - jnp.log(len(densities))

    return member_map(usual)(peers, batch.obs[ROLE], batch.first, batch.raw[ROLE])


def with_bonus(
    policy: Policy, params: Params, batch: "Batch", hyper: Mapping[str, jax.Array]
) -> "tuple[Batch, dict[str, jax.Array]]":
    """Pay for what the population seldom does: r - c log (1/n) sum_j pi_j(a | o).

    Logged are the population's entropy, and what of it is due to differences: between 0, where
    all humans act alike, and log n, where none would do what another does.
    """
    usual = log_mean_density(policy, params, hyper["peers"], batch)
    reward = batch.reward - hyper["population_coef"][:, None, None] * usual
    return dataclasses.replace(batch, reward=reward), {
        "population_entropy": -usual.mean((1, 2)),
        "population_divergence": (batch.log_prob[ROLE] - usual).mean((1, 2)),
    }
