"""Soft actor-critic (Haarnoja et al., 2018) of many teams at once: ISAC and MASAC.

Each role has a tanh-squashed Gaussian, two critics with slow copies, and a temperature. Critics of
ISAC read the role's observation and action; those of MASAC read the global observation and both
actions. A policy is improved by its critics' values of its new action and the other role's replayed
one. Whole rounds of collecting and learning stand in one program; the replay is part of its state.
"""

import dataclasses
import math
from typing import Any

import jax
import jax.numpy as jnp
import optax

from population.environment import Environment
from population.hyperparameters import SACConfig
from population.networks.members import member_map
from population.networks.policy import Gaussian, normalise
from population.networks.seat import Params
from population.networks.spec import Role
from population.partners.frozen import FrozenPartners
from population.trainers import experience, normaliser, replay_buffer
from population.trainers.experience import Sampler
from population.trainers.replay_buffer import Replay, Transitions
from population.trainers.sac_losses import (
    critic_loss,
    policy_loss,
    soft_target,
    temperature_gradient,
)
from population.trainers.trainer import (
    Hyper,
    MemberState,
    Metrics,
    Trainer,
    TrainState,
    descended,
    optimiser,
)

# Largest exploring action, below 1 so that its raw action is finite.
_UNIFORM_LIMIT = 0.999


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks of one role, and the optimiser state of those that are trained."""

    networks: dict[str, Any]  # "actor"; "critic": the twins "first" and "second"; "log_alpha"
    target: Params  # the critics' slow copies
    optimisers: dict[str, Any]  # by the names of networks


class SAC(Trainer):
    """SAC trainer: `isac` has local critics, `masac` central ones."""

    def __init__(
        self,
        config: SACConfig,
        env: Environment,
        updates: int,
        partners: FrozenPartners | None = None,
    ) -> None:
        super().__init__(config, env, updates, partners)
        if config.critic == "central" and partners:
            raise ValueError(
                "critic is 'central', which reads both roles' next actions, and partners are "
                "frozen: choose local"
            )

    def update(
        self, state: TrainState, hyper: Hyper, partners: Any = ()
    ) -> tuple[TrainState, Metrics]:
        """Return the state after a rollout and learning, and metrics [M], 0 while exploring."""
        exploring = self._exploring(state)
        state, batch, keys = self.collect(state, partners)
        batch = experience.by_member(batch, len(keys))
        actions = {role: jnp.tanh(raw) for role, raw in batch.raw.items()}
        replay = replay_buffer.add(state.replay, batch, actions)

        def learn(members: MemberState) -> tuple[MemberState, Metrics]:
            keys_of = jax.vmap(jax.random.split)(keys)
            shape = (self.config.updates, self.config.batch_size)
            drawn = replay_buffer.draw(replay, keys_of[:, 0], shape)
            return member_map(self._learn)(members, drawn, hyper, keys_of[:, 1])

        def wait(members: MemberState) -> tuple[MemberState, Metrics]:
            return members, jax.tree.map(
                lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(learn, members)[1]
            )

        members, metrics = jax.lax.cond(exploring, wait, learn, state.members)
        statistics = members.statistics
        if self.config.normalise:
            merge = jax.vmap(normaliser.update)
            statistics = {name: merge(statistics[name], batch.obs[name]) for name in self.inputs}
        members = dataclasses.replace(members, statistics=statistics)
        metrics |= jax.vmap(experience.episode_metrics)(batch)
        return TrainState(members, state.simulations, state.update + 1, replay), metrics

    def sampler(self, state: TrainState) -> Sampler:
        """Return the sampler of raw actions: uniform while exploring, else the policy's."""
        exploring = self._exploring(state)

        def sample(gaussian: Gaussian, key: jax.Array) -> jax.Array:
            drawn, explored = jax.random.split(key)
            uniform = jax.random.uniform(
                explored, gaussian.mean.shape, minval=-_UNIFORM_LIMIT, maxval=_UNIFORM_LIMIT
            )
            return jnp.where(exploring, jnp.arctanh(uniform), gaussian.sample(drawn))

        return sample

    def initial_replay(self, members: int) -> Replay:
        """Return an empty replay for all members, no longer than the run."""
        config, steps = self.config, self.config.batch_steps
        return replay_buffer.empty(
            members,
            math.ceil(min(config.replay_size, self.updates * steps) / steps),
            config.rollout_steps,
            config.num_envs,
            {name: self.env.observation_size[name] for name in self.inputs},
            {role: self.env.action_size[role] for role in self.roles},
        )

    def initial_learner(self, roles: tuple[Role, ...], key: jax.Array) -> Learner:
        """Return one member's learner of `roles`, which must be one role."""
        [role] = roles
        actor, first, second = jax.random.split(key, 3)
        critic = {
            "first": self.critics[role].init(first),
            "second": self.critics[role].init(second),
        }
        networks = {
            "actor": self.policies[role].init(actor, self.config.initial_log_std),
            "critic": critic,
            "log_alpha": jnp.log(jnp.asarray(self.config.initial_alpha)),
        }
        networks["actor"].pop("normaliser", None)
        optimisers = {
            name: self._optimiser(name, 1.0).init(params) for name, params in networks.items()
        }
        return Learner(networks, critic, optimisers)

    def _exploring(self, state: TrainState) -> jax.Array:
        """Return whether actions are still random, [] bool."""
        return state.update * self.config.batch_steps < self.config.exploration_steps

    def _learn(
        self, member: MemberState, drawn: Transitions, hyper: Hyper, key: jax.Array
    ) -> tuple[MemberState, Metrics]:
        """Return a member after learning from U minibatches, leaves [U, B, ...], and mean metrics.

        After every `policy_delay` steps of the critics, policy and temperature take as many, on the
        same minibatches: the delay lets critics settle and costs the policy no steps.
        """
        config = self.config
        groups = jax.tree.map(
            lambda leaf: leaf.reshape(-1, config.policy_delay, *leaf.shape[1:]), drawn
        )
        keys = jax.random.split(
            key, (config.updates // config.policy_delay, 2, config.policy_delay)
        )

        def improve(
            learners: dict[str, Learner], group: tuple[Transitions, jax.Array]
        ) -> tuple[dict[str, Learner], Metrics]:
            batches, keys = group
            learners, critic_metrics = jax.lax.scan(
                lambda learners, x: self._improve_critics(learners, member, *x, hyper),
                learners,
                (batches, keys[0]),
            )
            learners, policy_metrics = jax.lax.scan(
                lambda learners, x: self._improve_policies(learners, member, *x, hyper),
                learners,
                (batches, keys[1]),
            )
            return learners, critic_metrics | policy_metrics

        learners, metrics = jax.lax.scan(improve, member.learners, (groups, keys))
        return dataclasses.replace(member, learners=learners), jax.tree.map(jnp.mean, metrics)

    def _improve_critics(
        self,
        learners: dict[str, Learner],
        member: MemberState,
        batch: Transitions,
        key: jax.Array,
        hyper: Hyper,
    ) -> tuple[dict[str, Learner], Metrics]:
        """Return the learners after a step of each critic towards a minibatch's soft targets."""
        new, metrics = {}, {}
        next_action, next_log_prob = self._act(learners, member, batch.next_obs, key)
        for role, learner in learners.items():
            next_q = self._values(role, learner.target, member, batch.next_obs, next_action)
            alpha = jnp.exp(learner.networks["log_alpha"])
            target = soft_target(
                batch.reward, batch.terminated, next_q, next_log_prob[role], alpha, hyper["gamma"]
            )
            new[role], logged = self._improve_critic(role, learner, member, batch, target, hyper)
            metrics |= logged
        return new, metrics

    def _improve_critic(
        self,
        role: str,
        learner: Learner,
        member: MemberState,
        batch: Transitions,
        target: jax.Array,
        hyper: Hyper,
    ) -> tuple[Learner, Metrics]:
        """Return a learner after a step of its critics and their slow copies, and metrics."""

        def loss(critic: Params) -> tuple[jax.Array, jax.Array]:
            q = self._values(role, critic, member, batch.obs, batch.action)
            return critic_loss(q, target), q

        gradient, q = jax.grad(loss, has_aux=True)(learner.networks["critic"])
        clipped = self._optimiser("critic", hyper["max_grad_norm"])
        learner = descended(learner, "critic", gradient, clipped, hyper["q_lr"])
        slow = optax.incremental_update(learner.networks["critic"], learner.target, hyper["tau"])
        return dataclasses.replace(learner, target=slow), {
            f"q_loss_{role}": jnp.square(q - target[None]).mean(),
            f"q_{role}": q.mean(),
            f"critic_grad_norm_{role}": optax.tree.norm(gradient),
        }

    def _improve_policies(
        self,
        learners: dict[str, Learner],
        member: MemberState,
        batch: Transitions,
        key: jax.Array,
        hyper: Hyper,
    ) -> tuple[dict[str, Learner], Metrics]:
        """Return the learners after a step of every role's policy and temperature, and metrics."""
        new, metrics = {}, {}
        for role, role_key in zip(learners, jax.random.split(key, len(learners)), strict=True):
            new[role], logged = self._improve_policy(
                role, learners[role], member, batch, role_key, hyper
            )
            metrics |= logged
        return new, metrics

    def _improve_policy(
        self,
        role: str,
        learner: Learner,
        member: MemberState,
        batch: Transitions,
        key: jax.Array,
        hyper: Hyper,
    ) -> tuple[Learner, Metrics]:
        """Return a learner after a step of its policy and temperature, and metrics."""
        log_alpha, critic = learner.networks["log_alpha"], learner.networks["critic"]

        def loss(actor: Params) -> tuple[jax.Array, jax.Array]:
            action, log_prob = self._draw(role, actor, member, batch.obs[role], key)
            q = self._values(role, critic, member, batch.obs, {**batch.action, role: action})
            return policy_loss(jnp.exp(log_alpha), log_prob, q), log_prob

        (value, log_prob), gradient = jax.value_and_grad(loss, has_aux=True)(
            learner.networks["actor"]
        )
        clipped = self._optimiser("actor", hyper["max_grad_norm"])
        learner = descended(learner, "actor", gradient, clipped, hyper["policy_lr"])
        if self.config.autotune:
            target = -hyper["target_entropy_scale"] * self.specs[role].action_size
            slope = temperature_gradient(log_alpha, log_prob, target)
            plain = self._optimiser("log_alpha", jnp.inf)
            learner = descended(learner, "log_alpha", slope, plain, hyper["alpha_lr"])
        return learner, {
            f"policy_loss_{role}": value,
            f"entropy_{role}": -log_prob.mean(),
            f"alpha_{role}": jnp.exp(log_alpha),
            f"actor_grad_norm_{role}": optax.tree.norm(gradient),
        }

    def _act(
        self,
        learners: dict[str, Learner],
        member: MemberState,
        obs: dict[str, jax.Array],
        key: jax.Array,
    ) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        """Return drawn actions in [-1, 1] and their log densities, by role, at obs [B, O]."""
        keys = jax.random.split(key, len(learners))
        drawn = {
            role: self._draw(role, learners[role].networks["actor"], member, obs[role], role_key)
            for role, role_key in zip(learners, keys, strict=True)
        }
        return {role: pair[0] for role, pair in drawn.items()}, {
            role: pair[1] for role, pair in drawn.items()
        }

    def _draw(
        self, role: str, actor: Params, member: MemberState, obs: jax.Array, key: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Return a role's drawn actions in [-1, 1] and their log densities, at obs [B, O]."""
        first = jnp.zeros(obs.shape[:-1], bool)
        params = self.actor(role, member, {"actor": actor})
        _, gaussian = self.policies[role].step(params, (), obs, first)
        raw = gaussian.sample(key)
        return gaussian.action(raw), gaussian.log_prob(raw)

    def _values(
        self,
        role: str,
        critic: Params,
        member: MemberState,
        obs: dict[str, jax.Array],
        action: dict[str, jax.Array],
    ) -> jax.Array:
        """Return the values of a role's two critics [2, B]."""
        name = self.critic_obs[role]
        seen = obs[name]
        if self.config.normalise:
            seen = normalise(normaliser.to_params(member.statistics[name]), seen)
        seen = jnp.concatenate(
            [seen, *(action[other] for other in self._critic_actions(role))], axis=-1
        )
        first = jnp.zeros(seen.shape[:-1], bool)
        return jnp.stack(
            [
                self.critics[role].step(critic[twin], (), seen, first)[1]
                for twin in ("first", "second")
            ]
        )

    def critic_width(self, role: str) -> int:
        """Return the width of a role's critic inputs: observation and actions."""
        actions = (self.env.action_size[other] for other in self._critic_actions(role))
        return super().critic_width(role) + sum(actions)

    def _critic_actions(self, role: str) -> tuple[str, ...]:
        """Return the roles whose actions a role's critics read."""
        return self.roles if self.config.critic == "central" else (role,)

    def _optimiser(
        self, name: str, max_grad_norm: jax.Array | float
    ) -> optax.GradientTransformation:
        """Return the optimiser of a network; a temperature is one number and is not clipped."""
        return optimiser(self.config.adam_eps, None if name == "log_alpha" else max_grad_norm)
