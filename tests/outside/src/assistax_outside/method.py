"""A method of training robots: PPO that pays for jerky actions."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp

from population.methods.method import Method
from population.methods.ppo_loss import Metrics, Samples
from population.networks.policy import Policy
from population.networks.seat import Carry, Params
from population.networks.unrolled import unroll_policy


class Careful(Method):
    """Adds the mean of |a_t - a_(t-1)|^2 within episodes: a robot learns to move smoothly."""

    preset = {"aux_coef": 0.1}  # noqa: RUF012

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return the mean squared change of the likeliest action from step to step, and log it."""
        _, gaussian = unroll_policy(policy, params, carry, samples.obs, samples.first)
        change = jnp.square(gaussian.mean[1:] - gaussian.mean[:-1]).mean(-1)
        same_episode = ~samples.first[1:]
        loss = (change * same_episode).sum() / jnp.maximum(same_episode.sum(), 1)
        return loss, {"jerk": loss}
