"""Proximal policy optimisation (Schulman et al., 2017) of teams: IPPO and MAPPO for many members at once.

Robot and human are trained by their own networks, optimisers and gradient clips. Everything after the rollout is
written for one member and mapped over members; the environment sees one flat axis of simulations.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax

from population import gae, normaliser, rollout
from population.config import TRACED, Member, PPOConfig
from population.critic import Critic, CriticSpec
from population.networks import Carry, Params, normalise
from population.normaliser import Statistics
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
    """Networks of one role, each with its optimiser state."""

    networks: dict[str, Params]  # "actor" and "critic"
    optimisers: dict[str, Any]  # by the same names
    critic_carry: Carry  # [N, ...]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MemberState:
    """What a member learns; leaves [M, ...] for all members."""

    learners: dict[str, Learner]  # by role
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
    """Trains teams in an environment; `initial` and `update` may be jitted.

    Raises:
        ValueError: If the rollout is longer than an episode.
    """

    def __init__(self, config: PPOConfig, env: Environment, updates: int) -> None:
        if config.rollout_steps > env.episode_length:
            raise ValueError(
                f"rollout_steps is {config.rollout_steps}; an episode of {env.task} has {env.episode_length} steps, "
                "so choose at most that many"
            )
        self.config = config
        self.env = env
        self.updates = updates
        self.specs: dict[str, PolicySpec] = policy_specs(config, env)
        self.policies = {role: Policy(spec) for role, spec in self.specs.items()}
        self.critic_input: dict[str, str] = {role: "global" if config.critic == "central" else role for role in ROLES}
        self.inputs = tuple(dict.fromkeys([*ROLES, *self.critic_input.values()]))
        self.critics: dict[str, Critic] = {
            role: Critic(CriticSpec(env.observation_size[name], config.torso, config.hidden, config.activation))
            for role, name in self.critic_input.items()
        }

    def initial(self, keys: jax.Array, env_params: Any) -> TrainState:
        """Return the state before the first update.

        Args:
            keys: One key for each member [M].
            env_params: Parameters of the environment for each simulation [N], member by member.
        """
        split = jax.vmap(lambda key: jax.random.split(key, 4))(keys)
        env_state = self.env.reset(self._simulation_keys(split[:, 0]), env_params)
        stagger = jax.vmap(lambda key: jax.random.randint(key, (self.config.num_envs,), 0, self.env.episode_length))
        return TrainState(
            members=rollout.member_map(self._initial_member)(split[:, 2], split[:, 3]),
            simulations=rollout.begin(env_state, self.policies, len(keys), stagger(split[:, 1]).reshape(-1)),
            update=jnp.zeros((), jnp.int32),
        )

    def update(self, state: TrainState, hyper: Hyper) -> tuple[TrainState, Metrics]:
        """Collect one rollout and learn from it; metrics are [M]."""
        count = state.update.astype(jnp.float32)
        if self.config.anneal_lr:
            rate = hyper.learning_rate * (1.0 - count / self.updates)
            hyper = dataclasses.replace(hyper, learning_rate=rate)
        keys = jax.vmap(lambda key: jax.random.split(key, 4))(state.members.key)
        fresh = self.env.reset(self._simulation_keys(keys[:, 0]), state.simulations.env.params)
        act_keys = jax.vmap(lambda key: jax.random.split(key, self.config.rollout_steps), out_axes=1)(keys[:, 1])
        simulations, batch = rollout.collect(
            self.env, self.policies, self.policy_params(state.members), act_keys, state.simulations, fresh, self.inputs
        )
        members = dataclasses.replace(state.members, key=keys[:, 3])
        batch = rollout.by_member(batch, len(keys))
        members, metrics = rollout.member_map(self._learn)(members, batch, hyper, keys[:, 2])
        return TrainState(members, simulations, state.update + 1), metrics

    def policy_params(self, members: MemberState) -> dict[str, Params]:
        """Return parameters as `Policy` reads them, by role; leaves [M, ...]."""
        return {
            role: self._with_normaliser(role, members, learner.networks["actor"])
            for role, learner in members.learners.items()
        }

    def _initial_member(self, key: jax.Array, carried: jax.Array) -> MemberState:
        learners = {}
        for role, role_key in zip(ROLES, jax.random.split(key, len(ROLES)), strict=True):
            actor, critic = jax.random.split(role_key)
            networks = {"actor": self.policies[role].init(actor), "critic": self.critics[role].init(critic)}
            networks["actor"].pop("normaliser", None)
            learners[role] = Learner(
                networks=networks,
                optimisers={name: _optimiser(self.config, 1.0).init(params) for name, params in networks.items()},
                critic_carry=self.critics[role].initial_carry((self.config.num_envs,)),
            )
        statistics = {name: normaliser.empty(self.env.observation_size[name]) for name in self.inputs}
        return MemberState(learners, statistics, carried)

    def _learn(self, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array) -> tuple[MemberState, Metrics]:
        """Improve both roles of one member on its batch, then update its observation statistics.

        The statistics change only after learning: within an update, probability ratios compare policies that read
        the same normalised observations, and start at exactly 1.
        """
        learners, metrics = {}, _episode_metrics(batch)
        for role, role_key in zip(ROLES, jax.random.split(key, len(ROLES)), strict=True):
            learners[role], losses = self._learn_role(role, member, batch, hyper, role_key)
            metrics |= {f"{name}_{role}": value for name, value in losses.items()}
        statistics = member.statistics
        if self.config.normalise:
            statistics = {name: normaliser.update(statistics[name], batch.obs[name]) for name in self.inputs}
        return MemberState(learners, statistics, member.key), metrics

    def _learn_role(
        self, role: str, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[Learner, Metrics]:
        learner, name = member.learners[role], self.critic_input[role]
        stats = normaliser.to_params(member.statistics[name])
        obs, final_obs, last_obs = (x[name] for x in (batch.obs, batch.final_obs, batch.last_obs))
        if self.config.normalise:
            obs, final_obs, last_obs = (normalise(stats, x) for x in (obs, final_obs, last_obs))
        carry, value, next_value = gae.values(
            self.critics[role],
            learner.networks["critic"],
            learner.critic_carry,
            obs,
            batch.first,
            batch.truncated,
            final_obs,
            last_obs,
            batch.last_first,
        )
        advantage = gae.advantages(
            batch.reward, value, next_value, batch.terminated, batch.truncated, hyper.gamma, hyper.gae_lambda
        )
        samples = _Samples(
            obs=batch.obs[role],
            critic_obs=obs,
            first=batch.first,
            raw=batch.raw[role],
            log_prob=batch.log_prob[role],
            advantage=advantage,
            target=advantage + value,
        )
        carries = (batch.carry[role], learner.critic_carry)
        networks, optimisers, losses = self._descend(role, member, samples, carries, hyper, key)
        losses["explained_variance"] = 1.0 - jnp.var(advantage) / (jnp.var(samples.target) + 1e-8)
        return Learner(networks, optimisers, carry), losses

    def _descend(
        self, role: str, member: MemberState, samples: "_Samples", carries: Any, hyper: Hyper, key: jax.Array
    ) -> tuple[dict[str, Params], dict[str, Any], Metrics]:
        """Take a step for each minibatch of each epoch; a minibatch is a random set of whole simulations."""
        config, learner = self.config, member.learners[role]

        def descend(state: tuple[Any, Any], rows: jax.Array) -> tuple[tuple[Any, Any], Metrics]:
            networks, optimisers = state
            part = jax.tree.map(lambda leaf: jnp.take(leaf, rows, axis=1, mode="clip"), samples)
            part_carries = jax.tree.map(lambda leaf: jnp.take(leaf, rows, axis=0, mode="clip"), carries)
            gradients, losses = jax.grad(self._loss, argnums=1, has_aux=True)(
                role, networks, member, part, part_carries, hyper
            )
            for name in networks:
                losses[f"{name}_grad_norm"] = optax.tree.norm(gradients[name])
                steps, optimiser = _optimiser(config, hyper.max_grad_norm).update(gradients[name], optimisers[name])
                networks = {**networks, name: _descended(networks[name], steps, hyper.learning_rate)}
                optimisers = {**optimisers, name: optimiser}
            return (networks, optimisers), losses

        keys = jax.random.split(key, config.epochs)
        rows = jax.vmap(lambda key: jax.random.permutation(key, config.num_envs))(keys)
        rows = rows.reshape(config.epochs * config.minibatches, config.num_envs // config.minibatches)
        (networks, optimisers), losses = jax.lax.scan(descend, (learner.networks, learner.optimisers), rows)
        return networks, optimisers, jax.tree.map(jnp.mean, losses)

    def _loss(
        self,
        role: str,
        networks: dict[str, Params],
        member: MemberState,
        samples: "_Samples",
        carries: tuple[Carry, Carry],
        hyper: Hyper,
    ) -> tuple[jax.Array, Metrics]:
        """Return the clipped surrogate loss with value loss and entropy bonus, and what to log."""
        actor = self._with_normaliser(role, member, networks["actor"])
        _, gaussian = self.policies[role].unroll(actor, carries[0], samples.obs, samples.first)
        _, value = self.critics[role].unroll(networks["critic"], carries[1], samples.critic_obs, samples.first)
        log_ratio = gaussian.log_prob(samples.raw) - samples.log_prob
        ratio = jnp.exp(log_ratio)
        advantage = (samples.advantage - samples.advantage.mean()) / (samples.advantage.std() + 1e-8)
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

    def _with_normaliser(self, role: str, member: MemberState, actor: Params) -> Params:
        if not self.config.normalise:
            return actor
        return {**actor, "normaliser": normaliser.to_params(member.statistics[role])}

    def _simulation_keys(self, keys: jax.Array) -> jax.Array:
        """Return one key for each simulation [N] from one for each member [M]."""
        return jax.vmap(lambda key: jax.random.split(key, self.config.num_envs))(keys).reshape(-1)


def policy_specs(config: PPOConfig, env: Environment) -> dict[str, PolicySpec]:
    """Return the network shapes of both roles."""
    names = ("torso", "hidden", "activation", "squash", "std", "normalise")
    shared = {name: getattr(config, name) for name in names}
    return {role: PolicySpec(role, env.observation_size[role], env.action_size[role], **shared) for role in ROLES}


def hyperparameters(config: PPOConfig, members: Sequence[Member]) -> Hyper:
    """Return the traced hyperparameters of every member: the config's, or its own."""
    rows = {name: [member.overrides.get(name, getattr(config, name)) for member in members] for name in TRACED}
    return Hyper(**{name: jnp.asarray(values, jnp.float32) for name, values in rows.items()})


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

    Actor and critic are clipped apart: value errors in the hundreds would otherwise use up the norm they share.
    """
    return optax.chain(optax.clip_by_global_norm(max_grad_norm), optax.scale_by_adam(eps=config.adam_eps))


def _descended(params: Params, steps: Any, learning_rate: jax.Array) -> Params:
    return jax.tree.map(lambda leaf, step: leaf - learning_rate * step, params, steps)


def _episode_metrics(batch: Batch) -> Metrics:
    """Return the mean sums of the whole episodes that ended (NaN without any), and counts."""
    finished = batch.finished.sum()
    means = {name: value.sum() / finished for name, value in batch.finished_sums.items()}
    return {
        **means,
        "episodes": finished,
        "reward": batch.reward.mean(),
        "nonfinite": batch.nonfinite.sum(),
    }
