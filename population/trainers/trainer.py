"""Base of PPO and SAC: state of members, collection of rollouts, and a step of descent.

Everything after the rollout is written for one member and mapped over members; the environment
sees one flat axis of simulations. Each network has an optimiser and a gradient clip of its own:
value errors in the hundreds would otherwise use up the norm that a policy shares with its critic.
"""

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import optax

from assistax_envs import select
from assistax_envs.preferences import PREFERRED, WIDTH
from population.config import Member, traced_values
from population.environment import Environment
from population.hyperparameters import TrainerConfig
from population.networks.members import member_map
from population.networks.policy import Critic, CriticSpec, Gaussian, Policy
from population.networks.seat import Params
from population.networks.spec import ROLES, PolicySpec, Role
from population.partners.frozen import FrozenPartners
from population.trainers import experience, normaliser
from population.trainers.experience import Batch, Sampler, Simulations
from population.trainers.normaliser import Statistics

Metrics = dict[str, jax.Array]
Hyper = dict[str, jax.Array]  # the config's `traced` ones; [M] for all members, scalars for one
L = TypeVar("L")  # a trainer's learner


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MemberState:
    """State of a member's learning; leaves [M, ...] for all members."""

    learners: dict[str, Any]  # the trainer's `Learner` by role, or one that is "shared"
    statistics: dict[str, Statistics]  # of the observations, by role and "global"
    key: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TrainState:
    """Complete state of a run, from which it can resume."""

    members: MemberState
    simulations: Simulations
    update: jax.Array  # updates done
    replay: Any = ()  # past transitions, of a trainer that learns from them


class Trainer(abc.ABC):
    """Trainer of teams, or of egos with partners; `initial` and `update` may be jitted.

    Args:
        config: Hyperparameters.
        env: The environment.
        updates: Length of the run.
        partners: Partners in the other seat; without them robot and human learn together.

    Raises:
        ValueError: If the rollout is longer than an episode, or partners do not fit.
    """

    sees: tuple[str, ...] = ()  # observations in a rollout beside those of networks
    watches = False  # whether a rollout holds the partner's actions and speeds
    series = 1  # episodes over which a robot remembers its partner

    def __init__(
        self,
        config: Any,
        env: Environment,
        updates: int,
        partners: FrozenPartners | None = None,
    ) -> None:
        _check(config, env, partners)
        self.config, self.env, self.updates, self.partners = config, env, updates, partners
        self.roles: tuple[Role, ...] = tuple(
            role for role in ROLES if not partners or role != partners.role
        )
        self.specs = _policy_specs(config, env, self.roles)
        self.policies = {role: self.policy(spec) for role, spec in self.specs.items()}
        # Learners by name, each of one role.
        self.learners: dict[str, tuple[Role, ...]] = {role: (role,) for role in self.roles}
        # Observation that a role's critic reads: the role's own, or "global".
        self.critic_obs: dict[str, str] = {
            role: "global" if config.critic == "central" else role for role in self.roles
        }
        self.inputs = tuple(dict.fromkeys([*self.roles, *self.critic_obs.values(), *self.sees]))
        self.critics: dict[str, Critic] = {
            role: self.critic(self.critic_width(role)) for role in self.roles
        }

    def hyper(self, members: Sequence[Member]) -> Hyper:
        """Return the traced hyperparameters [M] of every member: the config's, or its own."""
        values = traced_values(self.config, members)
        return {name: jnp.asarray(row, jnp.float32) for name, row in values.items()}

    def initial(self, keys: jax.Array, env_params: Any) -> TrainState:
        """Return the state before the first update.

        Args:
            keys: One key for each member [M].
            env_params: Parameters of the environment for each simulation [N], member by member.
        """
        split = jax.vmap(lambda key: jax.random.split(key, 4))(keys)
        envs, length = self.config.num_envs, self.env.episode_length
        env_state = self._reset(split[:, 0], env_params, jnp.zeros(()))
        stagger = jax.vmap(lambda key: jax.random.randint(key, (envs,), 0, length))(split[:, 1])
        return TrainState(
            members=member_map(self._initial_member)(split[:, 2], split[:, 3]),
            simulations=experience.begin(
                env_state, self.policies, len(keys), stagger.reshape(-1), self.partners, self.series
            ),
            update=jnp.zeros((), jnp.int32),
            replay=self.initial_replay(len(keys)),
        )

    def collect(self, state: TrainState, partners: Any = ()) -> tuple[TrainState, Batch, jax.Array]:
        """Return the state after a rollout, the rollout, and keys [M] for learning from it.

        Each member's key is split in four: for resets, for actions, for learning, and the next.
        """
        members = state.members
        keys = jax.vmap(lambda key: jax.random.split(key, 4))(members.key)
        share = state.update.astype(jnp.float32) / self.updates  # of the run that is done
        simulations = state.simulations
        fresh = self._reset(keys[:, 0], simulations.env.params, share, simulations.series)
        steps = self.config.rollout_steps
        act_keys = jax.vmap(lambda key: jax.random.split(key, steps), out_axes=1)(keys[:, 1])
        simulations, batch = experience.collect(
            self.env,
            self.policies,
            self.acting(state),
            act_keys,
            state.simulations,
            fresh,
            self.inputs,
            self.partners,
            partners,
            self.sampler(state),
            self.watches,
            self.series,
        )
        members = dataclasses.replace(members, key=keys[:, 3])
        state = dataclasses.replace(state, members=members, simulations=simulations)
        return state, batch, keys[:, 2]

    @abc.abstractmethod
    def update(
        self, state: TrainState, hyper: Hyper, partners: Any = ()
    ) -> tuple[TrainState, Metrics]:
        """Return the state after one rollout and learning from it, and metrics [M].

        `partners` are the parameters of frozen partners.
        """

    @abc.abstractmethod
    def initial_learner(self, roles: tuple[Role, ...], key: jax.Array) -> Any:
        """Return one member's learner of these roles."""

    def policy_params(self, members: MemberState) -> dict[str, Params]:
        """Return parameters as `Policy` reads them, by role; leaves [M, ...]."""
        return {
            role: self.actor(role, members, members.learners[name].networks)
            for name, roles in self.learners.items()
            for role in roles
        }

    def policy(self, spec: PolicySpec) -> Policy:
        """Return the policy that acts in training for a spec."""
        return Policy(spec)

    def acting(self, state: TrainState) -> dict[str, Params]:
        """Return the parameters that act in the next rollout, by role; leaves [M, ...]."""
        return self.policy_params(state.members)

    def critic(self, width: int) -> Critic:
        """Return a critic for inputs of a width."""
        config = self.config
        return Critic(CriticSpec(width, config.torso, config.hidden, config.activation))

    def critic_width(self, role: str) -> int:
        """Return the width of a role's critic inputs."""
        return self.env.observation_size[self.critic_obs[role]]

    def sampler(self, state: TrainState) -> Sampler:
        """Return the sampler of raw actions in the next rollout."""
        return Gaussian.sample

    def initial_replay(self, members: int) -> Any:
        """Return an empty replay for all members; () if the trainer has none."""
        return ()

    def actor(self, role: str, member: MemberState, networks: Mapping[str, Params]) -> Params:
        """Return a role's parameters as `Policy` reads them, including the normaliser.

        Leading axes of the leaves are free.
        """
        stats = self.normalisers(member)
        return {**networks["actor"], "normaliser": stats[role]} if stats else networks["actor"]

    def normalisers(self, member: MemberState) -> dict[str, Params]:
        """Return the normaliser of each observation by name; {} without normalisation."""
        named = member.statistics if self.config.normalise else {}
        return {name: normaliser.to_params(statistics) for name, statistics in named.items()}

    def _reset(self, keys: jax.Array, humans: Any, share: jax.Array, series: Any = ()) -> Any:
        """Return the environment's state at the start of an episode in each simulation [N].

        `keys` are the members' [M], `share` is the part of the run that is done. Within a series
        the human and its preference stay.
        """
        keys = _simulation_keys(keys, self.config.num_envs)
        if not self.partners:
            return self.env.reset(keys, self._lenient(humans, share))
        new = self._lenient(self.partners.renewed(humans, keys), share)
        if self.series > 1:
            new = self.partners.settled(new, keys)
        if series:
            new = select(series.turn < self.series - 1, humans, new)
        return self.env.reset(keys, new)

    def _lenient(self, humans: Any, share: jax.Array) -> Any:
        """Return the humans [N] with the width of their liking after a share of the run."""
        more = self.config.liking_width - WIDTH
        if more <= 0.0 or self.env.task not in PREFERRED:
            return humans
        width = WIDTH + more * jnp.maximum(1.0 - 2.0 * share, 0.0)
        return dataclasses.replace(humans, width=jnp.broadcast_to(width, humans.strength.shape))

    def _initial_member(self, key: jax.Array, carried: jax.Array) -> MemberState:
        """Return a member's initial state; `carried` is the key of its rollouts."""
        statistics = {
            name: normaliser.empty(self.env.observation_size[name]) for name in self.inputs
        }
        keys = role_keys(key)
        learners = {
            name: self.initial_learner(roles, keys[roles[0]])
            for name, roles in self.learners.items()
        }
        return MemberState(learners, statistics, carried)


def role_keys(key: jax.Array) -> dict[str, jax.Array]:
    """Return a key for each role; a robot's key is the same alone as in a team."""
    return dict(zip(ROLES, jax.random.split(key, len(ROLES)), strict=True))


def optimiser(
    adam_eps: float, max_grad_norm: jax.Array | float | None
) -> optax.GradientTransformation:
    """Return a network's optimiser before the learning rate: clip (unless None), then Adam."""
    adam = optax.scale_by_adam(eps=adam_eps)
    if max_grad_norm is None:
        return adam
    return optax.chain(optax.clip_by_global_norm(max_grad_norm), adam)


def minibatches(key: jax.Array, config: Any) -> jax.Array:
    """Return the simulations [epochs x minibatches, N / minibatches] of each minibatch, shuffled.

    A minibatch is a random set of whole simulations; `config` has epochs, minibatches, num_envs.
    """
    keys = jax.random.split(key, config.epochs)
    rows = jax.vmap(lambda key: jax.random.permutation(key, config.num_envs))(keys)
    return rows.reshape(config.epochs * config.minibatches, config.num_envs // config.minibatches)


def taken(tree: Any, rows: jax.Array, axis: int) -> Any:
    """Return the simulations `rows` of leaves whose axis `axis` is N."""
    return jax.tree.map(lambda leaf: jnp.take(leaf, rows, axis=axis, mode="clip"), tree)


def descended(
    learner: L, name: str, gradient: Any, optimiser: optax.GradientTransformation, rate: jax.Array
) -> L:
    """Return a learner after one step of one of its networks."""
    fields: Any = learner
    steps, state = optimiser.update(gradient, fields.optimisers[name])
    params = jax.tree.map(lambda leaf, step: leaf - rate * step, fields.networks[name], steps)
    return dataclasses.replace(
        fields,
        networks={**fields.networks, name: params},
        optimisers={**fields.optimisers, name: state},
    )


def _policy_specs(
    config: TrainerConfig, env: Environment, roles: Sequence[Role]
) -> dict[str, PolicySpec]:
    """Return the specs of the roles' policies."""
    names = ("torso", "hidden", "activation", "squash", "std", "normalise", "latent")
    same: dict[str, Any] = {name: getattr(config, name) for name in names}
    return {
        role: PolicySpec(role, env.observation_size[role], env.action_size[role], **same)
        for role in roles
    }


def _simulation_keys(keys: jax.Array, num_envs: int) -> jax.Array:
    """Return one key for each simulation [N] from one for each member [M]."""
    return jax.vmap(lambda key: jax.random.split(key, num_envs))(keys).reshape(-1)


def _check(config: TrainerConfig, env: Environment, partners: FrozenPartners | None) -> None:
    """Refuse a rollout longer than an episode, and partners that do not fit the environment."""
    if config.rollout_steps > env.episode_length:
        raise ValueError(
            f"rollout_steps is {config.rollout_steps}; an episode of {env.task} has "
            f"{env.episode_length} steps, so choose at most that many"
        )
    if partners:
        partners.check(env, config.num_envs)
