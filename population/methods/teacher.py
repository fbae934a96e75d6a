"""RMA: a teacher that reads all that is hidden, and a student that infers it.

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

STILLEST = 1e-3  # variance below which a latent counts as constant


class Teacher(Method):
    """Teacher and student: the teacher acts by pi(a | o, z*) with z* = e(hidden) in R^8, by PPO.

    The student acts by the same pi(a | o, z) with z = GRU(o, a), and learns
    L = E[|z - z*|^2 / dim(z) + |mu(o, z) - mu(o, z*)|^2 / dim(a)], in which z alone has a gradient.
    In the last `student_share` of a run the student acts, while pi and e are frozen (DAgger). With
    `student_share=0`, the ablation, the student learns from the teacher's rollouts alone. The
    published robot is the student.
    """

    sees = critic_sees = (HIDDEN,)

    def policy(self, spec: PolicySpec) -> Policy:
        """Return the network of both; the parameter "taught" says which of them acts."""
        return _TaughtPolicy(spec)

    def init(self, policy: Policy, key: jax.Array) -> dict[str, Params]:
        """Return the teacher's encoder of the hidden observation."""
        hidden = jnp.zeros(self.env.observation_size[HIDDEN])
        return {"teacher": TwoLayers(policy.spec.latent).init(key, hidden)["params"]}

    def acting(self, params: Params, networks: Mapping[str, Params], progress: jax.Array) -> Params:
        """Return the parameters of the rollout: the teacher's until the student's share begins."""
        members = jax.tree.leaves(networks)[0].shape[0]
        taught = jnp.broadcast_to(self._taught(progress), (members,))
        return {**params, "teacher": networks["teacher"], "taught": taught}

    def scheduled(self, hyper: Hyper, progress: jax.Array) -> Hyper:
        """Return the hyperparameters at a share of the run, with "taught" and "student_rate".

        The student's rate is not annealed: it learns at the end of a run.
        """
        taught = jnp.broadcast_to(self._taught(progress), hyper["aux_coef"].shape)
        rate = hyper["learning_rate"]
        if self.config.anneal_lr:
            rate = rate / (1.0 - progress)
        return {**hyper, "taught": taught.astype(jnp.float32), "student_rate": rate}

    def rate(self, network: str, hyper: Hyper) -> jax.Array:
        """Return a network's learning rate; only the student's memory learns to the end."""
        if network == "memory":
            return hyper["student_rate"]
        return hyper["learning_rate"] * hyper["taught"]

    def latent(self, networks: Mapping[str, Params], samples: Samples) -> jax.Array:
        """Return the teacher's latents [T, N, Z], with their gradient."""
        return _encoded(networks["teacher"], samples.beside[HIDDEN])

    def loss(
        self,
        networks: Mapping[str, Params],
        policy: Policy,
        params: Params,
        samples: Samples,
        carry: Carry,
    ) -> tuple[jax.Array, Metrics]:
        """Return the student's distance from the teacher, in latents and actions, and metrics.

        A metric is the latent's error as a share of its variance: 1 if the student knows the mean
        alone.
        """
        action = squashed(policy, samples.raw)
        _, latent = unroll_memory(policy, params, carry, samples.obs, samples.first, action)
        fixed = jax.lax.stop_gradient(params)
        target = jax.lax.stop_gradient(self.latent(networks, samples))
        target_action, action_mean = (
            policy.given(fixed, samples.obs, z).mean for z in (target, latent)
        )
        latent_error = jnp.square(latent - target).mean()
        action_error = jnp.square(action_mean - target_action).mean()
        share = latent_error / jnp.maximum(target.var((0, 1)).mean(), STILLEST)
        logged = {"student_latent_error": share, "student_action_error": action_error}
        return latent_error + action_error, logged

    def _taught(self, progress: jax.Array) -> jax.Array:
        share = self.config.student_share
        return progress < 1.0 - share if share else jnp.ones_like(progress, bool)


class _TaughtPolicy(Policy):
    """Policy of teacher and student; reads the hidden observation behind the role's own."""

    beside = (HIDDEN,)

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, Gaussian]:
        observation, hidden = jnp.split(obs, (self.spec.observation_size,), axis=-1)
        state, latent = self.recall(params, carry, observation, first)
        latent = jnp.where(params["taught"], _encoded(params["teacher"], hidden), latent)
        gaussian = self.given(params, observation, latent)
        return self.acted(state, gaussian.mode()), gaussian


def _encoded(params: Params, hidden: jax.Array) -> jax.Array:
    width = params["Dense_1"]["bias"].shape[-1]
    output: Any = TwoLayers(width).apply({"params": params}, hidden)
    return output
