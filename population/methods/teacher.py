"""A teacher that is told everything, and a student that has to find it out: RMA.

Kumar et al., 2021, "RMA: Rapid Motor Adaptation for Legged Robots". Ross et al., 2011, "A Reduction
of Imitation Learning and Structured Prediction to No-Regret Online Learning", is DAgger.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from population.methods.hidden import HIDDEN
from population.methods.latents import TwoLayers, squashed
from population.methods.method import Method
from population.methods.ppo_loss import Hyper, Metrics, Samples
from population.networks.policy import Gaussian, Policy
from population.networks.seat import Carry, Params
from population.networks.spec import PolicySpec
from population.networks.unrolled import unroll_memory

STILLEST = 1e-3  # variance below which a latent counts as always the same


class Teacher(Method):
    """The teacher acts by pi(a | o, z*) with z* = e(hidden) in R^8, and learns by PPO.

    The student acts by the same pi(a | o, z) with z = GRU(o, a), and learns
    L = E[|z - z*|^2 / dim(z) + |mu(o, z) - mu(o, z*)|^2 / dim(a)], in which z alone has a gradient.
    In the last `student_share` of a run the student acts, and pi and e stay as they are (DAgger).
    With `student_share=0`, the ablation, it learns from what the teacher does alone. The published
    robot is the student.
    """

    sees = critic_sees = (HIDDEN,)

    def policy(self, spec: PolicySpec) -> Policy:
        """Return the network of both: who acts says the parameter "taught"."""
        return _TaughtPolicy(spec)

    def init(self, policy: Policy, key: jax.Array) -> dict[str, Params]:
        """Return the teacher's encoder of what is hidden."""
        hidden = jnp.zeros(self.env.observation_size[HIDDEN])
        return {"teacher": TwoLayers(policy.spec.latent).init(key, hidden)["params"]}

    def acting(self, params: Params, networks: Mapping[str, Params], progress: jax.Array) -> Params:
        """Return the parameters of who acts in the rollout."""
        members = jax.tree.leaves(networks)[0].shape[0]
        taught = jnp.broadcast_to(self._taught(progress), (members,))
        return {**params, "teacher": networks["teacher"], "taught": taught}

    def scheduled(self, hyper: Hyper, progress: jax.Array) -> Hyper:
        """Return the hyperparameters at a share of the run.

        The student's rate does not fall with the others': its part is the end of a run.
        """
        taught = jnp.broadcast_to(self._taught(progress), hyper["aux_coef"].shape)
        rate = hyper["learning_rate"]
        if self.config.anneal_lr:
            rate = rate / (1.0 - progress)
        return {**hyper, "taught": taught.astype(jnp.float32), "student_rate": rate}

    def rate(self, network: str, hyper: Hyper) -> jax.Array:
        """Return the learning rate of a network: the student's memory alone learns to the end."""
        if network == "memory":
            return hyper["student_rate"]
        return hyper["learning_rate"] * hyper["taught"]

    def latent(self, networks: Mapping[str, Params], samples: Samples) -> jax.Array:
        """Return what the teacher makes of what is hidden, with its gradient."""
        return _encoded(networks["teacher"], samples.beside[HIDDEN])

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return how far the student is from the teacher.

        Logged is the latent's error as a share of its variance: 1 for who knows its mean alone.
        """
        action = squashed(policy, samples.raw)
        _, own = unroll_memory(policy, params, carry, samples.obs, samples.first, action)
        fixed = jax.lax.stop_gradient(params)
        told = jax.lax.stop_gradient(self.latent(networks, samples))
        wanted, done = (policy.given(fixed, samples.obs, z).mean for z in (told, own))
        latent_error = jnp.square(own - told).mean()
        action_error = jnp.square(done - wanted).mean()
        share = latent_error / jnp.maximum(told.var((0, 1)).mean(), STILLEST)
        logged = {"student_latent_error": share, "student_action_error": action_error}
        return latent_error + action_error, logged

    def _taught(self, progress: jax.Array) -> jax.Array:
        share = self.config.student_share
        return progress < 1.0 - share if share else jnp.ones_like(progress, bool)


class _TaughtPolicy(Policy):
    """Reads what is hidden behind the observation, and acts by the teacher's latent or its own."""

    beside = (HIDDEN,)

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, Gaussian]:
        own, hidden = jnp.split(obs, (self.spec.observation_size,), axis=-1)
        state, latent = self.recall(params, carry, own, first)
        latent = jnp.where(params["taught"], _encoded(params["teacher"], hidden), latent)
        gaussian = self.given(params, own, latent)
        return self.acted(state, gaussian.mode()), gaussian


def _encoded(params: Params, hidden: jax.Array) -> jax.Array:
    width = params["Dense_1"]["bias"].shape[-1]
    output: Any = TwoLayers(width).apply({"params": params}, hidden)
    return output
