"""Methods whose memory predicts the partner: LIAM, PALM with a bounded latent, and UP-OSI.

LIAM: Papoudakis et al., 2021, "Agent Modelling under Partial Observability for Deep Reinforcement
Learning". PALM: He et al., 2022, "Learning Representations that Enable Generalization in
Assistive Tasks". UP-OSI: Yu et al., 2017, "Preparing for the Unknown: Learning a Universal Policy
with Online System Identification".
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn

from assistax_envs.own_settings import key_of
from assistax_envs.preferences import PREFERRED
from population.methods.hidden import HIDDEN
from population.methods.latents import TwoLayers, squashed
from population.methods.method import Method
from population.methods.ppo_loss import Metrics, Samples
from population.networks.policy import Policy
from population.networks.seat import Carry, Params
from population.networks.unrolled import unroll_memory

STILLEST = 1e-3  # variance below which a partner's joint counts as still
NARROWEST = 8.0  # of the logarithm of a latent's variance, either way


class Modelling(Method):
    """Modelling of the partner: z = GRU(o, a) in R^16 predicts its next action and joint speeds.

    L = E[mean_i (f(z)_i - y_i)^2 / var(y_i)] + kl_coef KL(N(z, exp(l(h))) | N(0, 1)) / dim(z). Here
    f is a decoder, which training alone has, h the memory's state and y the partner's next action
    and joint speeds. With kl_coef = 0 (LIAM) f reads z; above 0 (PALM) it reads a draw from
    N(z, exp(l(h))). The policy reads z beside the observation, and its gradient does not reach
    the memory. `aux_coef=0` is the ablation: a memory that nothing trains.
    """

    watches = True

    def init(self, policy: Policy, key: jax.Array) -> dict[str, Params]:
        """Return the decoder and, if kl_coef > 0, the layer "spread" of latents' log variances."""
        if self.partners is None:
            raise ValueError(f"method {self.config.method!r} predicts partners; give partners")
        decoder, spread = jax.random.split(key)
        width = self.width()
        latent, hidden = policy.spec.latent, policy.spec.hidden[-1]
        networks = {"decoder": TwoLayers(width).init(decoder, jnp.zeros(latent))["params"]}
        if self.config.kl_coef:
            start = nn.initializers.zeros_init()
            spreads = nn.Dense(latent, kernel_init=start).init(spread, jnp.zeros(hidden))
            networks["spread"] = spreads["params"]
        return networks

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return the partner's prediction error (1 for the mean alone) plus the KL cost of z."""
        action = squashed(policy, samples.raw)
        states, z = unroll_memory(policy, params, carry, samples.obs, samples.first, action)
        drawn, kl = z, jnp.zeros(())
        if "spread" in networks:
            spread = networks["spread"]
            log_var = states @ spread["kernel"] + spread["bias"][None, None]
            log_var = jnp.clip(log_var, -NARROWEST, NARROWEST)
            drawn = z + jnp.exp(0.5 * log_var) * samples.noise
            kl = 0.5 * (jnp.square(z) + jnp.exp(log_var) - 1.0 - log_var).mean()
        target = self.target(samples)
        predicted: Any = TwoLayers(target.shape[-1]).apply({"params": networks["decoder"]}, drawn)
        error = jnp.square(predicted - target).mean((0, 1))
        model_loss = (error / jnp.maximum(target.var((0, 1)), STILLEST)).mean()
        loss = model_loss + self.config.kl_coef * kl
        return loss, {"model_loss": model_loss, "latent_kl": kl}

    def width(self) -> int:
        """Return the number of predicted quantities."""
        assert self.partners is not None
        joints = jax.eval_shape(self._joints).shape[-1]
        return self.env.action_size[self.partners.role] + joints

    def target(self, samples: Samples) -> jax.Array:
        """Return the predicted quantities [T, N, Y]."""
        return samples.partner

    def _joints(self) -> jax.Array:
        """Return the partner's joint positions [N, J] at a reset, traced for their shape alone."""
        assert self.partners is not None
        humans = self.partners.humans(self.config.num_envs)
        keys = jax.random.split(key_of(0), self.config.num_envs)
        return self.env.joint_positions(self.env.reset(keys, humans))[self.partners.role]


class Identification(Modelling):
    """Identification of what the partner likes: z = GRU(o, a) in R^16 predicts it.

    The loss is that of `Modelling`, with y the logarithm of each liked value over its middle. In a
    task without wishes y is all that is hidden. The critic sees all that is hidden.
    """

    watches = False
    sees = critic_sees = (HIDDEN,)

    def width(self) -> int:
        """See `Modelling.width`."""
        wishes = len(PREFERRED.get(self.env.task, ()))
        return wishes or self.env.observation_size[HIDDEN]

    def target(self, samples: Samples) -> jax.Array:
        """See `Modelling.target`: wishes come first in what is hidden."""
        return samples.beside[HIDDEN][..., : self.width()]
