"""DAgger (Ross et al., 2011): a robot learns to act like one that is told the wishes, its teacher.

The robot acts, and the teacher says at each step of its rollouts what it would have done. The robot
sees no wish, so what it learns is the mean of the teacher's actions over the wishes that fit what
it saw and heard. It explores nothing by itself, and no reward is read. A gru's memory also learns
to read what the teacher is told: a word changes little of what is to be done, and that much later.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax

from assistax_envs.tasks.speech import before_words
from population.config import Member
from population.environment import TEACHER, Environment, WithTeacher
from population.hyperparameters import DAggerConfig
from population.networks.members import member_map
from population.networks.policy import Policy
from population.networks.seat import Carry, Params
from population.networks.spec import Role
from population.networks.stack import PolicyStack
from population.networks.unrolled import unroll_policy, unroll_states
from population.partners.frozen import FrozenPartners
from population.trainers import experience, normaliser
from population.trainers.experience import Batch, Sampler
from population.trainers.trainer import (
    Hyper,
    MemberState,
    Metrics,
    Trainer,
    TrainState,
    descended,
    minibatches,
    optimiser,
    taken,
)

STILLEST = 1e-3  # variance below which a number counts as constant


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Learner:
    """Network of the robot with its optimiser state, and the teacher's memory."""

    networks: dict[str, Params]  # "actor", and "reader" of a gru's memory
    optimisers: dict[str, Any]  # by the same names
    teacher_carry: Carry  # [N, ...]


class DAgger(Trainer):
    """DAgger trainer of robots with frozen partners.

    Args:
        config: Hyperparameters.
        env: The environment of a gentle task, whose robot is told nothing.
        updates: Length of the run.
        partners: Partners in the human's seat.
        teacher: Robots that are told the wishes, one for each member, in their order.
        members: Number of members.

    Raises:
        ValueError: There are no partners or teachers, or these are of another task, or too few.
    """

    sees = (TEACHER,)

    def __init__(
        self,
        config: DAggerConfig,
        env: Environment,
        updates: int,
        partners: FrozenPartners | None,
        teacher: PolicyStack | None,
        members: int,
    ) -> None:
        if not partners or not teacher:
            raise ValueError(
                "dagger imitates a robot that is told the wishes, with partners who stay as they "
                "are: give partners, and a teacher that observes the preference"
            )
        if len(teacher) != members:
            raise ValueError(f"{members} robots learn from {len(teacher)} teachers; give one each")
        if teacher.spec.latent:
            raise ValueError(
                f"the teacher has a latent of {teacher.spec.latent}, whose memory reads actions "
                "that it did not take: give a teacher without, such as a gru"
            )
        self.teacher, self._taught = Policy(teacher.spec), teacher.params
        shown = WithTeacher(env, teacher.spec.observation_size)
        self._added = shown.added
        super().__init__(config, shown, updates, partners)

    def hyper(self, members: Sequence[Member]) -> Hyper:
        """Return the traced hyperparameters [M], and the parameters of the teachers."""
        return {**super().hyper(members), TEACHER: jax.tree.map(jnp.asarray, self._taught)}

    def sampler(self, state: TrainState) -> Sampler:
        """Return the sampler of raw actions: the most likely ones, as a finished robot acts."""
        return lambda gaussian, key: gaussian.mean

    def update(
        self, state: TrainState, hyper: Hyper, partners: Any = ()
    ) -> tuple[TrainState, Metrics]:
        """Return the state after one rollout and learning from it, and metrics [M]."""
        state, batch, keys = self.collect(state, partners)
        if self.config.anneal_lr:
            left = 1.0 - state.update.astype(jnp.float32) / self.updates
            hyper = {**hyper, "learning_rate": hyper["learning_rate"] * left}
        batch = experience.by_member(batch, len(keys))
        metrics = member_map(experience.episode_metrics)(batch)
        members, losses = member_map(self._learn)(state.members, batch, hyper, keys)
        state = dataclasses.replace(state, members=members, update=state.update + 1)
        return state, metrics | losses

    def initial_learner(self, roles: tuple[Role, ...], key: jax.Array) -> Learner:
        """Return one member's learner."""
        actor = self.policies[roles[0]].init(key, self.config.initial_log_std)
        actor.pop("normaliser", None)
        start = optimiser(self.config.adam_eps, 1.0)
        networks = {"actor": actor}
        if self.config.torso == "gru":
            networks["reader"] = {
                "kernel": jnp.zeros((self.config.hidden[-1], self._added)),
                "bias": jnp.zeros(self._added),
            }
        carry = self.teacher.initial_carry((self.config.num_envs,))
        started = {part: start.init(params) for part, params in networks.items()}
        return Learner(networks, started, carry)

    def _learn(
        self, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[MemberState, Metrics]:
        """Return a member after a step for each minibatch of each epoch, and metrics.

        "imitation_error" is the mean squared distance from the teacher's action, as a share of how
        much the teacher's actions vary, and "reading_error" the same of what the teacher is told.
        """
        [(name, [role])] = self.learners.items()
        learner, config = member.learners[name], self.config
        taught: Any = hyper[TEACHER]
        carry, told = unroll_policy(
            self.teacher, taught, learner.teacher_carry, batch.obs[TEACHER], batch.first
        )
        secret = before_words(batch.obs[TEACHER], self._added)
        samples = batch.obs[role], batch.first, told.mode(), secret
        carries, clipped = batch.carry[role], optimiser(config.adam_eps, hyper["max_grad_norm"])

        def step(learner: Learner, rows: jax.Array) -> tuple[Learner, Metrics]:
            part, start = taken(samples, rows, 1), taken(carries, rows, 0)
            gradients, logged = jax.grad(self._loss, has_aux=True)(
                learner.networks, role, member, part, start, hyper
            )
            for network, gradient in gradients.items():
                learner = descended(learner, network, gradient, clipped, hyper["learning_rate"])
            logged[f"actor_grad_norm_{name}"] = optax.tree.norm(gradients["actor"])
            return learner, logged

        learner, metrics = jax.lax.scan(step, learner, minibatches(key, config))
        metrics = jax.tree.map(jnp.mean, metrics)
        metrics["imitation_error"] /= jnp.maximum(told.mode().var((0, 1)).mean(), STILLEST)
        statistics = {
            name: normaliser.update(old, batch.obs[name]) for name, old in member.statistics.items()
        }
        learner = dataclasses.replace(learner, teacher_carry=carry)
        statistics = statistics if config.normalise else member.statistics
        return MemberState({name: learner}, statistics, member.key), metrics

    def _loss(
        self,
        networks: dict[str, Params],
        role: str,
        member: MemberState,
        samples: tuple[jax.Array, ...],
        carry: Carry,
        hyper: Hyper,
    ) -> tuple[jax.Array, Metrics]:
        """Return the loss of a minibatch, and the errors of acting and of reading."""
        obs, first, action, secret = samples
        params, policy = self.actor(role, member, networks), self.policies[role]
        if "reader" not in networks:
            _, acted = unroll_policy(policy, params, carry, obs, first)
            error = jnp.square(acted.mean - action).mean()
            return error, {"imitation_error": error}
        states, acted = unroll_states(policy, params, carry, obs, first)
        error = jnp.square(acted.mean - action).mean()
        read = states @ networks["reader"]["kernel"] + networks["reader"]["bias"][None, None]
        missed = jnp.square(read - secret).mean((0, 1)) / jnp.maximum(secret.var((0, 1)), STILLEST)
        reading = missed.mean()
        return error + hyper["aux_coef"] * reading, {
            "imitation_error": error,
            "reading_error": reading,
        }
