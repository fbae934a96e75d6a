"""Proximal policy optimisation (Schulman et al., 2017) of teams: IPPO and MAPPO for many members at once.

Robot and human are trained by their own networks, optimisers and gradient clips, or share one of
each; with frozen partners in one seat, only the other learns. Everything after the rollout is
written for one member and mapped over members; the environment sees one flat axis of simulations.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax

from population import gae, normaliser, rollout, sharing
from population.config import Member, PPOConfig, traced_values
from population.critic import Critic, CriticSpec
from population.mapping import member_map
from population.networks import Carry, Params, normalise
from population.normaliser import Statistics
from population.partners import Partners
from population.policy import Policy
from population.rollout import Batch, Environment, Simulations
from population.spec import ROLES, PolicySpec

Metrics = dict[str, jax.Array]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Hyper:
    """Traced hyperparameters; leaves [M] for all members, scalars for one."""

    learning_rate: jax.Array
    clip_eps: jax.Array
    entropy_coef: jax.Array
    value_coef: jax.Array
    gamma: jax.Array
    gae_lambda: jax.Array
    max_grad_norm: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks of one role, or of both that share them, each with its optimiser state."""

    networks: dict[str, Params]  # "actor" and "critic"
    optimisers: dict[str, Any]  # by the same names
    critic_carry: dict[str, Carry]  # by role [N, ...]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MemberState:
    """What a member learns; leaves [M, ...] for all members."""

    learners: dict[str, Learner]  # by role, or one that is "shared"
    statistics: dict[str, Statistics]  # of the observations, by role and "global"
    key: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TrainState:
    """Everything that a run needs to go on."""

    members: MemberState
    simulations: Simulations
    update: jax.Array  # updates done


class PPO:
    """Trains teams, or egos with partners, in an environment; `initial` and `update` may be jitted.

    Raises:
        ValueError: If the rollout is longer than an episode, or partners do not fit.
    """

    def __init__(
        self, config: PPOConfig, env: Environment, updates: int, partners: Partners | None = None
    ) -> None:
        rollout.check(env, config, partners)
        if config.shared and partners:
            raise ValueError(
                "shared is true, but partners are frozen and one role learns: leave shared out"
            )
        self.config = config
        self.env = env
        self.updates = updates
        self.partners = partners
        self.roles = rollout.learning_roles(partners)
        self.learners: dict[str, tuple[str, ...]] = (
            {sharing.SHARED: self.roles}
            if config.shared
            else {role: (role,) for role in self.roles}
        )
        self.specs: dict[str, PolicySpec] = rollout.policy_specs(config, env, self.roles)
        self.policies = {role: Policy(spec) for role, spec in self.specs.items()}
        self.critic_input: dict[str, str] = {
            role: "global" if config.critic == "central" else role for role in self.roles
        }
        self.inputs = tuple(dict.fromkeys([*self.roles, *self.critic_input.values()]))
        self.critics: dict[str, Critic] = {
            role: self._critic(env.observation_size[name])
            for role, name in self.critic_input.items()
        }

    def hyper(self, members: Sequence[Member]) -> Hyper:
        """Return the traced hyperparameters of every member: the config's, or its own."""
        values = traced_values(self.config, members)
        return Hyper(**{name: jnp.asarray(row, jnp.float32) for name, row in values.items()})

    def initial(self, keys: jax.Array, env_params: Any) -> TrainState:
        """Return the state before the first update.

        Args:
            keys: One key for each member [M].
            env_params: Parameters of the environment for each simulation [N], member by member.
        """
        split = jax.vmap(lambda key: jax.random.split(key, 4))(keys)
        env_state = self.env.reset(
            rollout.simulation_keys(split[:, 0], self.config.num_envs), env_params
        )
        stagger = jax.vmap(
            lambda key: jax.random.randint(key, (self.config.num_envs,), 0, self.env.episode_length)
        )
        return TrainState(
            members=member_map(self._initial_member)(split[:, 2], split[:, 3]),
            simulations=rollout.begin(
                env_state, self.policies, len(keys), stagger(split[:, 1]).reshape(-1), self.partners
            ),
            update=jnp.zeros((), jnp.int32),
        )

    def update(
        self, state: TrainState, hyper: Hyper, partners: Any = ()
    ) -> tuple[TrainState, Metrics]:
        """Collect one rollout and learn from it; metrics are [M], `partners` the parameters of frozen partners."""
        state, batch, keys = self.collect(state, partners)
        count = state.update.astype(jnp.float32)
        if self.config.anneal_lr:
            rate = hyper.learning_rate * (1.0 - count / self.updates)
            hyper = dataclasses.replace(hyper, learning_rate=rate)
        batch = rollout.by_member(batch, len(keys))
        members, metrics = member_map(self._learn)(state.members, batch, hyper, keys)
        return TrainState(members, state.simulations, state.update + 1), metrics

    def collect(self, state: TrainState, partners: Any = ()) -> tuple[TrainState, Batch, jax.Array]:
        """Return the state after a rollout, the rollout, and the keys [M] to learn from it with."""
        return rollout.collect_next(self, state, partners)

    def policy_params(self, members: MemberState) -> dict[str, Params]:
        """Return parameters as `Policy` reads them, by role; leaves [M, ...]."""
        params = {}
        for name, roles in self.learners.items():
            for role in roles:
                actor = self._actor(role, members.learners[name].networks["actor"])
                params[role] = self._with_normaliser(role, members, actor)
        return params

    def _initial_member(self, key: jax.Array, carried: jax.Array) -> MemberState:
        learners = {}
        # As many keys as there are roles, whoever learns: a robot starts the same with partners as
        # in a team.
        keys: dict[str, jax.Array] = dict(
            zip(ROLES, jax.random.split(key, len(ROLES)), strict=True)
        )
        for name, roles in self.learners.items():
            actor, critic = jax.random.split(keys[roles[0]])
            networks = {
                "actor": self._network(roles).init(actor),
                "critic": self._value_network(roles).init(critic),
            }
            networks["actor"].pop("normaliser", None)
            learners[name] = Learner(
                networks=networks,
                optimisers={
                    part: _optimiser(self.config, 1.0).init(params)
                    for part, params in networks.items()
                },
                critic_carry={
                    role: self.critics[role].initial_carry((self.config.num_envs,))
                    for role in roles
                },
            )
        statistics = {
            name: normaliser.empty(self.env.observation_size[name]) for name in self.inputs
        }
        return MemberState(learners, statistics, carried)

    def _learn(
        self, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[MemberState, Metrics]:
        """Improve both roles of one member on its batch, then update its observation statistics.

        The statistics change only after learning: within an update, probability ratios compare
        policies that read the same normalised observations, and start at exactly 1.
        """
        learners, metrics = {}, rollout.episode_metrics(batch)
        keys: dict[str, jax.Array] = dict(
            zip(ROLES, jax.random.split(key, len(ROLES)), strict=True)
        )
        for name, roles in self.learners.items():
            learners[name], losses = self._learn_role(name, member, batch, hyper, keys[roles[0]])
            metrics |= losses
        statistics = member.statistics
        if self.config.normalise:
            statistics = {
                name: normaliser.update(statistics[name], batch.obs[name]) for name in self.inputs
            }
        return MemberState(learners, statistics, member.key), metrics

    def _learn_role(
        self, name: str, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[Learner, Metrics]:
        """Improve a role's networks, or those that both share; return them and what to log."""
        learner = member.learners[name]
        samples, carries, critic_carry, explained = {}, {}, {}, {}
        for role in self.learners[name]:
            critic_carry[role], samples[role] = self._samples(role, member, learner, batch, hyper)
            carries[role] = (batch.carry[role], learner.critic_carry[role])
            advantage, target = samples[role].advantage, samples[role].target
            explained[f"explained_variance_{role}"] = 1.0 - jnp.var(advantage) / (
                jnp.var(target) + 1e-8
            )
        networks, optimisers, losses = self._descend(name, member, samples, carries, hyper, key)
        return Learner(networks, optimisers, critic_carry), losses | explained

    def _samples(
        self, role: str, member: MemberState, learner: Learner, batch: Batch, hyper: Hyper
    ) -> tuple[Carry, "_Samples"]:
        """Return the critic's carry after the batch, and what the role learns from."""
        name = self.critic_input[role]
        stats = normaliser.to_params(member.statistics[name])
        obs, final_obs, last_obs = (x[name] for x in (batch.obs, batch.final_obs, batch.last_obs))
        if self.config.normalise:
            obs, final_obs, last_obs = (normalise(stats, x) for x in (obs, final_obs, last_obs))
        carry, value, next_value = gae.values(
            self.critics[role],
            self._critic_params(role, learner.networks["critic"]),
            learner.critic_carry[role],
            obs,
            batch.first,
            batch.truncated,
            final_obs,
            last_obs,
            batch.last_first,
        )
        advantage = gae.advantages(
            batch.reward,
            value,
            next_value,
            batch.terminated,
            batch.truncated,
            hyper.gamma,
            hyper.gae_lambda,
        )
        return carry, _Samples(
            obs=batch.obs[role],
            critic_obs=obs,
            first=batch.first,
            raw=batch.raw[role],
            log_prob=batch.log_prob[role],
            advantage=advantage,
            target=advantage + value,
        )

    def _descend(
        self,
        name: str,
        member: MemberState,
        samples: "dict[str, _Samples]",
        carries: dict[str, tuple[Carry, Carry]],
        hyper: Hyper,
        key: jax.Array,
    ) -> tuple[dict[str, Params], dict[str, Any], Metrics]:
        """Take a step for each minibatch of each epoch; a minibatch is a random set of whole simulations."""
        config, learner = self.config, member.learners[name]

        def descend(state: tuple[Any, Any], rows: jax.Array) -> tuple[tuple[Any, Any], Metrics]:
            networks, optimisers = state
            part = jax.tree.map(lambda leaf: jnp.take(leaf, rows, axis=1, mode="clip"), samples)
            part_carries = jax.tree.map(
                lambda leaf: jnp.take(leaf, rows, axis=0, mode="clip"), carries
            )
            gradients, losses = jax.grad(self._loss, has_aux=True)(
                networks, member, part, part_carries, hyper
            )
            for part_name in networks:
                gradient = gradients[part_name]
                losses[f"{part_name}_grad_norm_{name}"] = optax.tree.norm(gradient)
                steps, optimiser = _optimiser(config, hyper.max_grad_norm).update(
                    gradient, optimisers[part_name]
                )
                networks = {
                    **networks,
                    part_name: _descended(networks[part_name], steps, hyper.learning_rate),
                }
                optimisers = {**optimisers, part_name: optimiser}
            return (networks, optimisers), losses

        keys = jax.random.split(key, config.epochs)
        rows = jax.vmap(lambda key: jax.random.permutation(key, config.num_envs))(keys)
        rows = rows.reshape(
            config.epochs * config.minibatches, config.num_envs // config.minibatches
        )
        (networks, optimisers), losses = jax.lax.scan(
            descend, (learner.networks, learner.optimisers), rows
        )
        return networks, optimisers, jax.tree.map(jnp.mean, losses)

    def _loss(
        self,
        networks: dict[str, Params],
        member: MemberState,
        samples: "dict[str, _Samples]",
        carries: dict[str, tuple[Carry, Carry]],
        hyper: Hyper,
    ) -> tuple[jax.Array, Metrics]:
        """Return the loss, its mean over roles where they share networks, and what to log."""
        loss, metrics = jnp.zeros(()), {}
        for role, part in samples.items():
            role_loss, logged = self._role_loss(role, networks, member, part, carries[role], hyper)
            loss = loss + role_loss / len(samples)
            metrics |= {f"{name}_{role}": value for name, value in logged.items()}
        return loss, metrics

    def _role_loss(
        self,
        role: str,
        networks: dict[str, Params],
        member: MemberState,
        samples: "_Samples",
        carries: tuple[Carry, Carry],
        hyper: Hyper,
    ) -> tuple[jax.Array, Metrics]:
        """Return the clipped surrogate loss with value loss and entropy bonus, and what to log."""
        actor = self._with_normaliser(role, member, self._actor(role, networks["actor"]))
        critic = self._critic_params(role, networks["critic"])
        _, gaussian = self.policies[role].unroll(actor, carries[0], samples.obs, samples.first)
        _, value = self.critics[role].unroll(critic, carries[1], samples.critic_obs, samples.first)
        log_ratio = gaussian.log_prob(samples.raw) - samples.log_prob
        ratio = jnp.exp(log_ratio)
        advantage = (samples.advantage - samples.advantage.mean()) / (
            samples.advantage.std() + 1e-8
        )
        clipped = jnp.clip(ratio, 1.0 - hyper.clip_eps, 1.0 + hyper.clip_eps)
        policy_loss = -jnp.minimum(ratio * advantage, clipped * advantage).mean()
        value_loss = 0.5 * jnp.square(value - samples.target).mean()
        entropy = gaussian.entropy().mean()
        loss = policy_loss + hyper.value_coef * value_loss - hyper.entropy_coef * entropy
        return loss, {
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "approx_kl": (ratio - 1.0 - log_ratio).mean(),
            "clip_fraction": (jnp.abs(ratio - 1.0) > hyper.clip_eps).mean(),
        }

    def _network(self, roles: tuple[str, ...]) -> Policy:
        """Return the network that is initialised: a role's own, or the one that roles share."""
        if len(roles) == 1:
            return self.policies[roles[0]]
        sizes = {role: self.specs[role] for role in roles}
        width = sharing.padded_size({role: spec.observation_size for role, spec in sizes.items()})
        actions = max(spec.action_size for spec in sizes.values())
        return Policy(
            dataclasses.replace(sizes[roles[0]], observation_size=width, action_size=actions)
        )

    def _value_network(self, roles: tuple[str, ...]) -> Critic:
        if len(roles) == 1:
            return self.critics[roles[0]]
        return self._critic(
            sharing.padded_size({role: self.critics[role].spec.observation_size for role in roles})
        )

    def _critic(self, observation_size: int) -> Critic:
        config = self.config
        return Critic(CriticSpec(observation_size, config.torso, config.hidden, config.activation))

    def _actor(self, role: str, params: Params) -> Params:
        """Return a role's ordinary parameters; leading axes of the leaves are free."""
        if not self.config.shared:
            return params
        return sharing.fold(
            params, role, self.specs[role].observation_size, self.specs[role].action_size
        )

    def _critic_params(self, role: str, params: Params) -> Params:
        return (
            sharing.fold(params, role, self.critics[role].spec.observation_size)
            if self.config.shared
            else params
        )

    def _with_normaliser(self, role: str, member: MemberState, actor: Params) -> Params:
        if not self.config.normalise:
            return actor
        return {**actor, "normaliser": normaliser.to_params(member.statistics[role])}


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Samples:
    """What one role learns from; leaves [T, N, ...]."""

    obs: jax.Array
    critic_obs: jax.Array
    first: jax.Array
    raw: jax.Array
    log_prob: jax.Array
    advantage: jax.Array
    target: jax.Array


def _optimiser(config: PPOConfig, max_grad_norm: jax.Array | float) -> optax.GradientTransformation:
    """Return clip and Adam of one network, before the learning rate.

    Actor and critic are clipped apart: value errors in the hundreds would otherwise use up the norm
    they share.
    """
    return optax.chain(
        optax.clip_by_global_norm(max_grad_norm), optax.scale_by_adam(eps=config.adam_eps)
    )


def _descended(params: Params, steps: Any, learning_rate: jax.Array) -> Params:
    return jax.tree.map(lambda leaf, step: leaf - learning_rate * step, params, steps)
