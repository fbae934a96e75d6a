"""Partners whom a model of the real ones imagines: GAMMA.

Liang et al., 2024, "Learning to Cooperate with Humans using Generative Agents".
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from population.methods.hidden import IMAGINED
from population.methods.latents import TwoLayers
from population.methods.method import Method
from population.methods.ppo_loss import Metrics, Samples
from population.networks.policy import Policy
from population.networks.seat import Carry, Params

if TYPE_CHECKING:
    from population.trainers.frozen_partners import FrozenPartners

LATENT = 8
STILLEST = 1e-3  # variance below which an action counts as always the same


class Imagining(Method):
    """A variational model g(o, z) of the partners' actions acts in `imagined_share` of simulations.

    L = E[mean_i (g(o, z)_i - a_i)^2 / var(a_i)] + kl_coef KL(q(z) | N(0, 1)) / dim(z), over what
    real partners did in a rollout's first episodes. q(z) = N(mu, sigma) has mu and log sigma from
    the mean over these steps of an encoder of (o, a). An imagined partner has body and wishes of
    the real one in whose place it sits, and a z in R^8 that is drawn for each of its episodes.
    `imagined_share=0` is the ablation.
    """

    sees = (IMAGINED,)
    watches = True
    noise = LATENT

    def __init__(self, config: Any, env: Any, partners: "FrozenPartners | None") -> None:
        super().__init__(config, env, partners)
        self._role = partners.role if partners else "human"
        self.sees = (self._role, IMAGINED)

    def init(self, policy: Policy, key: jax.Array) -> dict[str, Params]:
        """Return the model and its encoder."""
        encoder, model = jax.random.split(key)
        seen, acted = self.env.observation_size[self._role], self.env.action_size[self._role]
        return {
            "encoder": TwoLayers(2 * LATENT).init(encoder, jnp.zeros(seen + acted))["params"],
            "imagined": TwoLayers(acted).init(model, jnp.zeros(seen + LATENT))["params"],
        }

    def partner_params(
        self, networks: Mapping[str, Params], normalisers: Mapping[str, Params], real: Any
    ) -> Any:
        """Return the parameters of the partners: the real ones' and, [M, ...], the model's."""
        model = {**networks["imagined"]}
        if self._role in normalisers:
            model["normaliser"] = normalisers[self._role]
        return (real, model) if self.config.imagined_share else real

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return how badly the real partners are imagined, 1 for their mean alone."""
        obs = samples.beside[self._role]
        action = samples.partner[..., : self.env.action_size[self._role]]
        one_episode = jnp.cumsum(samples.first[1:], axis=0) == 0
        one_episode = jnp.concatenate([jnp.ones_like(samples.first[:1]), one_episode])
        weight = one_episode * (1.0 - samples.beside[IMAGINED][..., 0])
        made: Any = TwoLayers(2 * LATENT).apply(
            {"params": networks["encoder"]}, jnp.concatenate([obs, action], axis=-1)
        )
        steps = jnp.maximum(weight.sum(0), 1.0)[..., None]
        mean, log_std = jnp.split((weight[..., None] * made).sum(0) / steps, 2, axis=-1)
        log_std = jnp.clip(log_std, -4.0, 4.0)
        z = mean + jnp.exp(log_std) * samples.noise[0]
        z = jnp.broadcast_to(z[None], (*obs.shape[:-1], LATENT))
        error = jnp.square(predicted(networks["imagined"], obs, z) - action)
        total = jnp.maximum(weight.sum(), 1.0)
        centre = (weight[..., None] * action).sum((0, 1)) / total
        spread = (weight[..., None] * jnp.square(action - centre[None, None])).sum((0, 1)) / total
        error = (weight[..., None] * error).sum((0, 1)) / total
        model_loss = (error / jnp.maximum(spread, STILLEST)).mean()
        real = weight[0][:, None]
        kl = 0.5 * (jnp.square(mean) + jnp.exp(2.0 * log_std) - 1.0 - 2.0 * log_std)
        kl = (real * kl).sum() / jnp.maximum(real.sum(), 1.0) / np.float32(LATENT)
        loss = model_loss + self.config.kl_coef * kl
        return loss, {"model_loss": model_loss, "latent_kl": kl}


def predicted(model: Params, obs: jax.Array, z: jax.Array) -> jax.Array:
    """Return the actions [..., A] that a model predicts for normalised obs and latents."""
    width = model["Dense_1"]["bias"].shape[-1]
    seen = jnp.concatenate([obs, z], axis=-1)
    output: Any = TwoLayers(width).apply({"params": model}, seen)
    return jnp.tanh(output)
