"""Generalised advantage estimation with values at time limits."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from population.networks.policy import Critic
from population.networks.seat import Carry, Params
from population.networks.unrolled import unroll_critic


def advantages(
    reward: Float[Array, " T *batch"],
    value: Float[Array, " T *batch"],
    next_value: Float[Array, " T *batch"],
    terminated: Bool[Array, " T *batch"],
    truncated: Bool[Array, " T *batch"],
    gamma: Float[Array, ""] | float,
    lam: Float[Array, ""] | float,
) -> Float[Array, " T *batch"]:
    """Return advantages (Schulman et al., 2016, equation 16) for episodes that also end by time.

    delta_t = r_t + gamma (1 - terminated_t) V(next_t) - V_t and
    A_t = delta_t + gamma lam (1 - ended_t) A_{t+1}, where ended = terminated or truncated and
    next_t is the observation after step t before any reset.

    Args:
        reward: Rewards [T, ...].
        value: Values of the observations acted on [T, ...].
        next_value: Values of the observations reached, before any reset [T, ...].
        terminated: Whether the process ended for good: its value is then 0 [T, ...].
        truncated: Whether the time limit was reached: the value counts, the trace stops [T, ...].
        gamma: Discount.
        lam: Decay of the trace.
    """
    delta = reward + gamma * jnp.where(terminated, 0.0, next_value) - value
    ended = terminated | truncated

    def backward(
        trace: jax.Array, step: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array]:
        delta, ended = step
        trace = delta + gamma * lam * jnp.where(ended, 0.0, trace)
        return trace, trace

    _, result = jax.lax.scan(backward, jnp.zeros_like(delta[0]), (delta, ended), reverse=True)
    return result


def values(
    critic: Critic,
    params: Params,
    carry: Carry,
    obs: Float[Array, "T N O"],
    first: Bool[Array, "T N"],
    truncated: Bool[Array, "T N"],
    final_obs: Float[Array, "N O"],
    last_obs: Float[Array, "N O"],
    last_first: Bool[Array, " N"],
) -> tuple[Carry, Float[Array, "T N"], Float[Array, "T N"]]:
    """Return the carry after a chunk, and values [T, N] of observations and of their successors.

    A time limit occurs at most once for a simulation in a chunk, so one extra observation for each
    holds all of them.

    Args:
        critic: The critic.
        params: Its parameters.
        carry: Its carry at the start of the chunk.
        obs: Observations acted on [T, N, O].
        first: Whether they start an episode [T, N].
        truncated: Whether the step after them reached the time limit [T, N].
        final_obs: The observation at that time limit, before the reset [N, O]; unused where there
            was none.
        last_obs: The observation after the chunk [N, O].
        last_first: Whether it starts an episode [N].
    """
    if critic.spec.torso == "mlp":
        _, value = unroll_critic(critic, params, carry, obs, first)
        at_limit = carry
    else:
        carry, at_limit, value = _recurrent_values(critic, params, carry, obs, first, truncated)
    _, final = critic.step(params, at_limit, final_obs, jnp.zeros_like(last_first))
    _, last = critic.step(params, carry, last_obs, last_first)
    successor = jnp.concatenate([value[1:], last[None]])
    return carry, value, jnp.where(truncated, final[None], successor)


def _recurrent_values(
    critic: Critic,
    params: Params,
    carry: Carry,
    obs: jax.Array,
    first: jax.Array,
    truncated: jax.Array,
) -> tuple[Carry, Carry, jax.Array]:
    """Return a recurrent critic's last carry, its carry at the time limit, and values [T, N]."""

    def forward(
        state: tuple[Carry, Carry], x: tuple[jax.Array, ...]
    ) -> tuple[tuple[Carry, Carry], jax.Array]:
        carry, at_limit = state
        obs, first, truncated = x
        carry, value = critic.step(params, carry, obs, first)
        return (carry, jnp.where(truncated[:, None], carry, at_limit)), value

    (carry, at_limit), value = jax.lax.scan(forward, (carry, carry), (obs, first, truncated))
    return carry, at_limit, value
