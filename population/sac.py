"""Soft actor-critic (Haarnoja et al., 2018) of teams: ISAC and MASAC for many members at once.

Each role has a tanh-squashed Gaussian, two critics with slow copies, and a temperature. Critics of
ISAC read the role's observation and action; those of MASAC read the global observation and both
actions. A policy is improved against what its critics say of its own new action beside the replayed
one of the other role. Whole rounds of collecting and learning stand in one program; the replay is
part of its state.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax

from population import normaliser, replay, rollout
from population.config import Member, SACConfig, traced_values
from population.critic import Critic, CriticSpec
from population.mapping import member_map
from population.networks import Params, normalise
from population.normaliser import Statistics
from population.partners import Partners
from population.policy import Gaussian, Policy
from population.replay import Replay, Transitions
from population.rollout import Batch, Environment, Simulations
from population.spec import ROLES, PolicySpec

Metrics = dict[str, jax.Array]

_UNIFORM_LIMIT = (
    0.999  # of exploring actions: the squashed end of a raw action that is still finite
)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Hyper:
    """Traced hyperparameters; leaves [M] for all members, scalars for one."""

    policy_lr: jax.Array
    q_lr: jax.Array
    alpha_lr: jax.Array
    tau: jax.Array
    gamma: jax.Array
    target_entropy_scale: jax.Array
    max_grad_norm: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks of one role, and the optimiser state of what is descended."""

    networks: dict[str, Any]  # "actor"; "critic": the twins "first" and "second"; "log_alpha"
    target: Params  # the critics' slow copies
    optimisers: dict[str, Any]  # by the names of networks


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
    replay: Replay
    update: jax.Array  # rounds done


class SAC:
    """Trains teams, or egos with partners, in an environment; `initial` and `update` may be jitted.

    Raises:
        ValueError: If the rollout is longer than an episode, or partners do not fit.
    """

    def __init__(
        self, config: SACConfig, env: Environment, updates: int, partners: Partners | None = None
    ) -> None:
        rollout.check(env, config, partners)
        if config.critic == "central" and partners:
            raise ValueError(
                "critic is 'central', which reads both roles' next actions, and partners are "
                "frozen: choose local"
            )
        self.config = config
        self.env = env
        self.partners = partners
        self.slots = math.ceil(
            min(config.replay_size, updates * config.batch_steps) / config.batch_steps
        )
        self.roles = rollout.learning_roles(partners)
        self.specs: dict[str, PolicySpec] = rollout.policy_specs(config, env, self.roles)
        self.policies = {role: Policy(spec) for role, spec in self.specs.items()}
        central = config.critic == "central"
        self.critic_obs: dict[str, str] = {
            role: "global" if central else role for role in self.roles
        }
        self.critic_actions: dict[str, tuple[str, ...]] = {
            role: self.roles if central else (role,) for role in self.roles
        }
        self.inputs = tuple(dict.fromkeys([*self.roles, *self.critic_obs.values()]))
        self.critics: dict[str, Critic] = {role: self._critic(role) for role in self.roles}

    def initial(self, keys: jax.Array, env_params: Any) -> TrainState:
        """Return the state before the first update.

        Args:
            keys: One key for each member [M].
            env_params: Parameters of the environment for each simulation [N], member by member.
        """
        config = self.config
        split = jax.vmap(lambda key: jax.random.split(key, 4))(keys)
        env_state = self.env.reset(
            rollout.simulation_keys(split[:, 0], config.num_envs), env_params
        )
        stagger = jax.vmap(
            lambda key: jax.random.randint(key, (config.num_envs,), 0, self.env.episode_length)
        )
        return TrainState(
            members=member_map(self._initial_member)(split[:, 2], split[:, 3]),
            simulations=rollout.begin(
                env_state, self.policies, len(keys), stagger(split[:, 1]).reshape(-1), self.partners
            ),
            replay=replay.empty(
                len(keys),
                self.slots,
                config.rollout_steps,
                config.num_envs,
                {name: self.env.observation_size[name] for name in self.inputs},
                {role: self.env.action_size[role] for role in self.roles},
            ),
            update=jnp.zeros((), jnp.int32),
        )

    def hyper(self, members: Sequence[Member]) -> Hyper:
        """Return the traced hyperparameters of every member: the config's, or its own."""
        values = traced_values(self.config, members)
        return Hyper(**{name: jnp.asarray(row, jnp.float32) for name, row in values.items()})

    def update(
        self, state: TrainState, hyper: Hyper, partners: Any = ()
    ) -> tuple[TrainState, Metrics]:
        """Collect one rollout and, after exploring, learn from the replay; metrics are [M], losses 0 before that."""
        exploring = self._exploring(state)
        state, batch, keys = self.collect(state, partners)
        batch = rollout.by_member(batch, len(keys))
        kept = replay.add(
            state.replay, batch, {role: jnp.tanh(raw) for role, raw in batch.raw.items()}
        )

        def learn(members: MemberState) -> tuple[MemberState, Metrics]:
            keys_of = jax.vmap(jax.random.split)(keys)
            drawn = replay.draw(kept, keys_of[:, 0], (self.config.updates, self.config.batch_size))
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
        metrics |= jax.vmap(rollout.episode_metrics)(batch)
        return TrainState(members, state.simulations, kept, state.update + 1), metrics

    def collect(self, state: TrainState, partners: Any = ()) -> tuple[TrainState, Batch, jax.Array]:
        """Return the state after a rollout, the rollout, and the keys [M] to learn from it with."""
        exploring = self._exploring(state)

        def sample(gaussian: Gaussian, key: jax.Array) -> jax.Array:
            drawn, explored = jax.random.split(key)
            uniform = jax.random.uniform(
                explored, gaussian.mean.shape, minval=-_UNIFORM_LIMIT, maxval=_UNIFORM_LIMIT
            )
            return jnp.where(exploring, jnp.arctanh(uniform), gaussian.sample(drawn))

        return rollout.collect_next(self, state, partners, sample)

    def policy_params(self, members: MemberState) -> dict[str, Params]:
        """Return parameters as `Policy` reads them, by role; leaves [M, ...]."""
        return {
            role: self._actor(role, members, members.learners[role].networks["actor"])
            for role in self.roles
        }

    def _exploring(self, state: TrainState) -> jax.Array:
        return state.update * self.config.batch_steps < self.config.exploration_steps

    def _initial_member(self, key: jax.Array, carried: jax.Array) -> MemberState:
        learners = {}
        # As many keys as there are roles, whoever learns: a robot starts the same with partners as
        # in a team.
        for role, role_key in zip(ROLES, jax.random.split(key, len(ROLES)), strict=True):
            if role not in self.roles:
                continue
            actor, first, second = jax.random.split(role_key, 3)
            critic = {
                "first": self.critics[role].init(first),
                "second": self.critics[role].init(second),
            }
            networks = {
                "actor": self.policies[role].init(actor),
                "critic": critic,
                "log_alpha": jnp.log(jnp.asarray(self.config.initial_alpha)),
            }
            networks["actor"].pop("normaliser", None)
            learners[role] = Learner(
                networks=networks,
                target=critic,
                optimisers={
                    name: self._optimiser(name, 1.0).init(params)
                    for name, params in networks.items()
                },
            )
        statistics = {
            name: normaliser.empty(self.env.observation_size[name]) for name in self.inputs
        }
        return MemberState(learners, statistics, carried)

    def _learn(
        self, member: MemberState, drawn: Transitions, hyper: Hyper, key: jax.Array
    ) -> tuple[MemberState, Metrics]:
        """Improve one member on U minibatches, leaves [U, B, ...]: its critics on each, its policies behind them.

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
        """Take a step of every role's critics towards the soft targets of one minibatch [B, ...]."""
        new, metrics = {}, {}
        next_action, next_log_prob = self._act(learners, member, batch.next_obs, key)
        for role, learner in learners.items():
            next_q = self._values(role, learner.target, member, batch.next_obs, next_action)
            alpha = jnp.exp(learner.networks["log_alpha"])
            target = soft_target(
                batch.reward, batch.terminated, next_q, next_log_prob[role], alpha, hyper.gamma
            )

            def loss(
                critic: Params, role: str = role, target: jax.Array = target
            ) -> tuple[jax.Array, jax.Array]:
                q = self._values(role, critic, member, batch.obs, batch.action)
                return jnp.square(q - target[None]).mean(1).sum(), q

            gradient, q = jax.grad(loss, has_aux=True)(learner.networks["critic"])
            learner = self._descended(learner, "critic", gradient, hyper.q_lr, hyper.max_grad_norm)
            slow = optax.incremental_update(learner.networks["critic"], learner.target, hyper.tau)
            new[role] = dataclasses.replace(learner, target=slow)
            metrics |= {
                f"q_loss_{role}": jnp.square(q - target[None]).mean(),
                f"q_{role}": q.mean(),
                f"critic_grad_norm_{role}": optax.tree.norm(gradient),
            }
        return new, metrics

    def _improve_policies(
        self,
        learners: dict[str, Learner],
        member: MemberState,
        batch: Transitions,
        key: jax.Array,
        hyper: Hyper,
    ) -> tuple[dict[str, Learner], Metrics]:
        """Take a step of every role's policy and temperature on one minibatch [B, ...]."""
        new, metrics = {}, {}
        for role, role_key in zip(learners, jax.random.split(key, len(learners)), strict=True):
            learner = learners[role]
            log_alpha = learner.networks["log_alpha"]

            def loss(
                actor: Params,
                role: str = role,
                key: jax.Array = role_key,
                learner: Learner = learner,
            ) -> tuple[jax.Array, jax.Array]:
                action, log_prob = self._draw(role, actor, member, batch.obs[role], key)
                actions = {**batch.action, role: action}
                q = self._values(role, learner.networks["critic"], member, batch.obs, actions).min(
                    0
                )
                return (jnp.exp(learner.networks["log_alpha"]) * log_prob - q).mean(), log_prob

            (value, log_prob), gradient = jax.value_and_grad(loss, has_aux=True)(
                learner.networks["actor"]
            )
            learner = self._descended(
                learner, "actor", gradient, hyper.policy_lr, hyper.max_grad_norm
            )
            if self.config.autotune:
                surplus = (
                    -log_prob.mean() + hyper.target_entropy_scale * self.specs[role].action_size
                )
                rate = hyper.alpha_lr
                learner = self._descended(
                    learner, "log_alpha", jnp.exp(log_alpha) * surplus, rate, jnp.inf
                )
            new[role] = learner
            metrics |= {
                f"policy_loss_{role}": value,
                f"entropy_{role}": -log_prob.mean(),
                f"alpha_{role}": jnp.exp(log_alpha),
                f"actor_grad_norm_{role}": optax.tree.norm(gradient),
            }
        return new, metrics

    def _act(
        self,
        learners: dict[str, Learner],
        member: MemberState,
        obs: dict[str, jax.Array],
        key: jax.Array,
    ) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        """Return actions in [-1, 1] and their log densities, by role, at obs [B, O]."""
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
        first = jnp.zeros(obs.shape[:-1], bool)
        _, gaussian = self.policies[role].step(self._actor(role, member, actor), (), obs, first)
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
        """Return what both critics of a role say [2, B]."""
        name = self.critic_obs[role]
        seen = obs[name]
        if self.config.normalise:
            seen = normalise(normaliser.to_params(member.statistics[name]), seen)
        seen = jnp.concatenate(
            [seen, *(action[other] for other in self.critic_actions[role])], axis=-1
        )
        first = jnp.zeros(seen.shape[:-1], bool)
        return jnp.stack(
            [
                self.critics[role].step(critic[twin], (), seen, first)[1]
                for twin in ("first", "second")
            ]
        )

    def _actor(self, role: str, member: MemberState, actor: Params) -> Params:
        """Return an actor's parameters with what normalises its observations; leading axes are free."""
        if not self.config.normalise:
            return actor
        return {**actor, "normaliser": normaliser.to_params(member.statistics[role])}

    def _critic(self, role: str) -> Critic:
        width = self.env.observation_size[self.critic_obs[role]]
        width += sum(self.env.action_size[other] for other in self.critic_actions[role])
        return Critic(CriticSpec(width, "mlp", self.config.hidden, self.config.activation))

    def _optimiser(
        self, name: str, max_grad_norm: jax.Array | float
    ) -> optax.GradientTransformation:
        """Return clip and Adam of a network, before the learning rate; a temperature is not clipped."""
        adam = optax.scale_by_adam(eps=self.config.adam_eps)
        return (
            adam
            if name == "log_alpha"
            else optax.chain(optax.clip_by_global_norm(max_grad_norm), adam)
        )

    def _descended(
        self,
        learner: Learner,
        name: str,
        gradient: Any,
        rate: jax.Array,
        max_grad_norm: jax.Array | float,
    ) -> Learner:
        """Return the learner after one step of one of its networks."""
        optimiser = self._optimiser(name, max_grad_norm)
        steps, state = optimiser.update(gradient, learner.optimisers[name])
        params = jax.tree.map(lambda leaf, step: leaf - rate * step, learner.networks[name], steps)
        return dataclasses.replace(
            learner,
            networks={**learner.networks, name: params},
            optimisers={**learner.optimisers, name: state},
        )


def soft_target(
    reward: jax.Array,
    terminated: jax.Array,
    next_q: jax.Array,
    next_log_prob: jax.Array,
    alpha: jax.Array | float,
    gamma: jax.Array | float,
) -> jax.Array:
    """Return r + gamma (1 - terminated) (min_i Q_i(s', a') - alpha log pi(a' | s')).

    Haarnoja et al., 2018, "Soft Actor-Critic Algorithms and Applications", equations 3 and 6, with
    twin critics. A time limit is no termination: the value of what was reached counts.

    Args:
        reward: Rewards [B].
        terminated: Whether the process ended for good [B].
        next_q: What the slow critics say of the next observation and a new action there [2, B].
        next_log_prob: Log density of that action [B].
        alpha: Temperature.
        gamma: Discount.
    """
    value = next_q.min(0) - alpha * next_log_prob
    return reward + gamma * jnp.where(terminated, 0.0, value)
