"""Diversity of a population: the bonus of MEP.

Maximum Entropy Population-based training (Zhao et al., 2023, "Maximum Entropy Population-Based
Training for Zero-Shot Human-AI Coordination") pays a team for actions that are rare in its
population.
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

# The zoo's partners are humans. A robot has redundant joints, in which it could differ from other
# robots without an effect on the human.
ROLE = "human"


def peers(members: Sequence[Member]) -> Int[Array, "M n"]:
    """Return the indices of the members of each member's population, its own index included."""
    places = populations(members)
    return jnp.asarray([next(row for row in places if m in row) for m in range(len(members))])


def log_mean_density(
    policy: Policy, params: Params, peers: Int[Array, "M n"], batch: "Batch"
) -> Float[Array, "M T N"]:
    """Return log (1/n) sum_j pi_j(a | o): the population's log density of a human's actions.

    Args:
        policy: The humans' network, which keeps no state.
        params: Parameters of all members, leaves [M, ...].
        peers: As `peers` returns them.
        batch: Experience of the members, leaves [M, T, N, ...].
    """

    def of_member(peers: jax.Array, obs: jax.Array, first: jax.Array, raw: jax.Array) -> jax.Array:
        def density(peer: jax.Array) -> jax.Array:
            peer_params = jax.tree.map(lambda leaf: leaf[peer], params)
            return policy.step(peer_params, (), obs, first)[1].log_prob(raw)

        # One peer at a time, so that memory holds the activations of one network.
        densities = jax.lax.map(density, peers)
        return jax.nn.logsumexp(densities, axis=0) - jnp.log(len(densities))

    return member_map(of_member)(peers, batch.obs[ROLE], batch.first, batch.raw[ROLE])


def with_bonus(
    policy: Policy, params: Params, batch: "Batch", hyper: Mapping[str, jax.Array]
) -> "tuple[Batch, dict[str, jax.Array]]":
    """Return the batch with reward r - c log (1/n) sum_j pi_j(a | o), and metrics to log.

    The metrics are the population's entropy and its divergence: 0 if all humans act alike, and log
    n if each human's actions are impossible for the others.
    """
    log_density = log_mean_density(policy, params, hyper["peers"], batch)
    reward = batch.reward - hyper["population_coef"][:, None, None] * log_density
    return dataclasses.replace(batch, reward=reward), {
        "population_entropy": -log_density.mean((1, 2)),
        "population_divergence": (batch.log_prob[ROLE] - log_density).mean((1, 2)),
    }
