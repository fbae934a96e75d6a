"""Losses of soft actor-critic, in the order of their use in a minibatch.

Haarnoja et al., 2018, "Soft Actor-Critic Algorithms and Applications", with twin critics.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def soft_target(
    reward: Float[Array, " B"],
    terminated: Bool[Array, " B"],
    next_q: Float[Array, "2 B"],
    next_log_prob: Float[Array, " B"],
    alpha: Float[Array, ""] | float,
    gamma: Float[Array, ""] | float,
) -> Float[Array, " B"]:
    """Return r + gamma (1 - terminated) (min_i Q_i(s', a') - alpha log pi(a' | s')).

    Haarnoja et al., 2018, "Soft Actor-Critic Algorithms and Applications", equations 3 and 6, with
    twin critics. A time limit is not a termination: the value of the state reached counts.

    Args:
        reward: Rewards [B].
        terminated: Whether the process ended for good [B].
        next_q: Values by the slow critics of the next observation and a new action there [2, B].
        next_log_prob: Log density of that action [B].
        alpha: Temperature.
        gamma: Discount.
    """
    value = next_q.min(0) - alpha * next_log_prob
    return reward + gamma * jnp.where(terminated, 0.0, value)


def critic_loss(q: Float[Array, "2 B"], target: Float[Array, " B"]) -> Float[Array, ""]:
    """Return sum_i E[(Q_i(s, a) - target)^2] (Haarnoja et al., 2018, equation 5, twice it).

    Args:
        q: Values by both critics of replayed actions [2, B].
        target: Their soft targets [B].
    """
    return jnp.square(q - target[None]).mean(1).sum()


def policy_loss(
    alpha: Float[Array, ""], log_prob: Float[Array, " B"], q: Float[Array, "2 B"]
) -> Float[Array, ""]:
    """Return E[alpha log pi(a | s) - min_i Q_i(s, a)] (Haarnoja et al., 2018, equation 7).

    Args:
        alpha: Temperature.
        log_prob: Log densities of new actions [B].
        q: Values of them by both critics [2, B].
    """
    return (alpha * log_prob - q.min(0)).mean()


def temperature_gradient(
    log_alpha: Float[Array, ""], log_prob: Float[Array, " B"], target_entropy: Float[Array, ""]
) -> Float[Array, ""]:
    """Return the slope of J = E[-alpha log pi - alpha target] over log alpha.

    dJ / dlog alpha = alpha (H - target) with the entropy H = -E[log pi] (Haarnoja et al., 2018,
    equation 18).

    Args:
        log_alpha: Logarithm of the temperature.
        log_prob: Log densities of new actions [B].
        target_entropy: Entropy that the temperature aims at.
    """
    return jnp.exp(log_alpha) * (-log_prob.mean() - target_entropy)
