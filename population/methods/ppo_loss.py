"""Samples that PPO learns from, and PPO's loss."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from population.networks.policy import Gaussian

Metrics = dict[str, jax.Array]
Hyper = dict[str, jax.Array]  # the config's `traced` ones; [M] for all members, scalars for one


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Samples:
    """Samples of one role for learning; leaves [T, N, ...]."""

    obs: jax.Array
    critic_obs: jax.Array  # normalised
    first: jax.Array
    raw: jax.Array  # raw actions
    log_prob: jax.Array  # of the raw actions, when they were drawn
    advantage: jax.Array
    target: jax.Array  # of the value
    beside: dict[str, jax.Array]  # observations that the method sees
    partner: Any = ()  # the partner's actions and speeds, if the method watches: `Batch.partner`
    latent: Any = ()  # the memory's latents, if the policy reads any
    noise: Any = ()  # standard normal, of the latent's shape


def ppo_loss(
    gaussian: Gaussian, value: Float[Array, "T N"], samples: Samples, hyper: Hyper
) -> tuple[Float[Array, ""], Metrics]:
    """Return PPO's loss of one role, and metrics to log.

    L = -E[min(r A, clip(r, 1 - eps, 1 + eps) A)] + c_v E[(V - target)^2] / 2 - c_e E[H], where
    r = exp(log pi(a | o) - log pi_old(a | o)) and A are the advantages, normalised over the
    minibatch (Schulman et al., 2017, "Proximal Policy Optimization Algorithms", equations 7 and 9,
    negated).

    Args:
        gaussian: The policy now at the samples' observations [T, N, A].
        value: The critic's values there [T, N].
        samples: A minibatch; leaves [T, N, ...].
        hyper: eps is `clip_eps`, c_v `value_coef` and c_e `entropy_coef`; scalars.
    """
    log_ratio = gaussian.log_prob(samples.raw) - samples.log_prob
    ratio = jnp.exp(log_ratio)
    advantage = (samples.advantage - samples.advantage.mean()) / (samples.advantage.std() + 1e-8)
    clipped = jnp.clip(ratio, 1.0 - hyper["clip_eps"], 1.0 + hyper["clip_eps"])
    policy_loss = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
    value_loss = 0.5 * jnp.square(value - samples.target).mean()
    entropy = gaussian.entropy().mean()
    loss = policy_loss + hyper["value_coef"] * value_loss - hyper["entropy_coef"] * entropy
    return loss, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "approx_kl": (ratio - 1.0 - log_ratio).mean(),
        "clip_fraction": (jnp.abs(ratio - 1.0) > hyper["clip_eps"]).mean(),
    }
