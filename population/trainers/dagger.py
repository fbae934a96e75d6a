"""DAgger (Ross et al., 2011): a robot learns to act like one that is told the wishes, its teacher.

The robot acts, and the teacher says at each step of its rollouts what it would have done. The robot
sees no wish, so what it learns is the mean of the teacher's actions over the wishes that fit what
it saw and heard. It explores nothing by itself, and no reward is read.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax

from population.config import Member
from population.environment import TEACHER, Environment, WithTeacher
from population.hyperparameters import DAggerConfig
from population.networks.members import member_map
from population.networks.policy import Policy
from population.networks.seat import Carry, Params
from population.networks.spec import Role
from population.networks.stack import PolicyStack
from population.networks.unrolled import unroll_policy
from population.trainers import experience, normaliser
from population.trainers.experience import Batch, Sampler
from population.trainers.frozen_partners import FrozenPartners
from population.trainers.trainer import (
    Hyper,
    MemberState,
    Metrics,
    Trainer,
    TrainState,
    descended,
    optimiser,
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Learner:
    """Network of the robot with its optimiser state, and the teacher's memory."""

    networks: dict[str, Params]  # "actor"
    optimisers: dict[str, Any]  # by the same name
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
        super().__init__(config, WithTeacher(env, teacher.spec.observation_size), updates, partners)

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
        carry = self.teacher.initial_carry((self.config.num_envs,))
        return Learner({"actor": actor}, {"actor": start.init(actor)}, carry)

    def _learn(
        self, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[MemberState, Metrics]:
        """Return a member after a step for each minibatch of each epoch, and metrics.

        A minibatch is a random set of whole simulations. "imitation_error" is the mean squared
        distance from the teacher's action, as a share of how much the teacher's actions vary.
        """
        [(name, [role])] = self.learners.items()
        learner, config = member.learners[name], self.config
        taught: Any = hyper[TEACHER]
        carry, told = unroll_policy(
            self.teacher, taught, learner.teacher_carry, batch.obs[TEACHER], batch.first
        )
        samples, carries = (batch.obs[role], batch.first, told.mode()), batch.carry[role]
        clipped = optimiser(config.adam_eps, hyper["max_grad_norm"])

        def loss(actor: Params, samples: Any, carry: Carry) -> jax.Array:
            obs, first, action = samples
            params = self.actor(role, member, {"actor": actor})
            _, acted = unroll_policy(self.policies[role], params, carry, obs, first)
            return jnp.square(acted.mean - action).mean()

        def step(learner: Learner, rows: jax.Array) -> tuple[Learner, Metrics]:
            part = jax.tree.map(lambda leaf: jnp.take(leaf, rows, axis=1, mode="clip"), samples)
            start = jax.tree.map(lambda leaf: jnp.take(leaf, rows, axis=0, mode="clip"), carries)
            error, gradient = jax.value_and_grad(loss)(learner.networks["actor"], part, start)
            learner = descended(learner, "actor", gradient, clipped, hyper["learning_rate"])
            norm = {f"actor_grad_norm_{name}": optax.tree.norm(gradient)}
            return learner, {"imitation_error": error, **norm}

        keys = jax.random.split(key, config.epochs)
        rows = jax.vmap(lambda key: jax.random.permutation(key, config.num_envs))(keys)
        size = config.num_envs // config.minibatches
        learner, metrics = jax.lax.scan(step, learner, rows.reshape(-1, size))
        metrics = jax.tree.map(jnp.mean, metrics)
        metrics["imitation_error"] /= jnp.maximum(told.mode().var((0, 1)).mean(), 1e-6)
        statistics = {
            name: normaliser.update(old, batch.obs[name]) for name, old in member.statistics.items()
        }
        learner = dataclasses.replace(learner, teacher_carry=carry)
        statistics = statistics if config.normalise else member.statistics
        return MemberState({name: learner}, statistics, member.key), metrics
