"""Proximal policy optimisation (Schulman et al., 2017) of many teams at once: IPPO and MAPPO.

Robot and human have a network, an optimiser and a gradient clip each, or share one of each. With
frozen partners in one seat, only the other seat learns.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import optax

from population.config import Member
from population.environment import Environment
from population.hyperparameters import PPOConfig
from population.methods import diversity
from population.methods.hidden import WithHidden, beside
from population.methods.latents import latents
from population.methods.method import method_class
from population.methods.ppo_loss import Samples, ppo_loss
from population.networks import shared_network
from population.networks.members import member_map
from population.networks.policy import Critic, Policy, normalise
from population.networks.seat import Carry, Params
from population.networks.spec import PolicySpec, Role
from population.networks.unrolled import unroll_both, unroll_critic
from population.partners.frozen import FrozenPartners
from population.trainers import experience, gae, normaliser
from population.trainers.experience import Batch
from population.trainers.trainer import (
    Hyper,
    MemberState,
    Metrics,
    Trainer,
    TrainState,
    descended,
    minibatches,
    optimiser,
    role_keys,
    taken,
)

_METHOD = 1  # folded into a learner's key for the networks that a method adds


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Learner:
    """Networks of one role, or of both if they share them, each with its optimiser state."""

    networks: dict[str, Params]  # "actor" and "critic"
    optimisers: dict[str, Any]  # by the same names
    critic_carry: dict[str, Carry]  # by role [N, ...]


class PPO(Trainer):
    """PPO trainer: `ippo` has local critics, `mappo` central ones, `mep` IPPO's and a bonus."""

    def __init__(
        self,
        config: PPOConfig,
        env: Environment,
        updates: int,
        partners: FrozenPartners | None = None,
    ) -> None:
        if not partners and (config.method or config.series > 1):
            raise ValueError(
                f"method is {config.method!r} and series {config.series}, by which robots train "
                "with frozen partners: give partners, or leave them out"
            )
        kind = method_class(config.method)
        if kind.sees and partners:
            env = WithHidden(env, partners, config.num_envs)
        self.method = kind(config, env, partners)
        self.sees, self.watches = self.method.sees, kind.watches
        self.series = config.series
        super().__init__(config, env, updates, partners)
        if config.shared and partners:
            raise ValueError(
                "shared is true, but partners are frozen and one role learns: leave shared out"
            )
        if config.shared:
            self.learners = {shared_network.SHARED: self.roles}

    def hyper(self, members: Sequence[Member]) -> Hyper:
        """Return the traced hyperparameters [M], and "peers" if members form populations."""
        hyper = super().hyper(members)
        if self.config.population_coef:
            hyper["peers"] = diversity.peers(members)
        return hyper

    def update(
        self, state: TrainState, hyper: Hyper, partners: Any = ()
    ) -> tuple[TrainState, Metrics]:
        """Return the state after one rollout and learning from it, and metrics [M]."""
        config = self.config
        state, batch, keys = self.collect(state, partners)
        left = 1.0 - self._progress(state)
        annealed = {
            "learning_rate": config.anneal_lr,
            "entropy_coef": config.anneal_entropy,
            "population_coef": config.anneal_entropy,
        }
        hyper = {n: value * left if annealed.get(n) else value for n, value in hyper.items()}
        hyper = self.method.scheduled(hyper, self._progress(state))
        batch = experience.by_member(batch, len(keys))
        metrics = member_map(experience.episode_metrics)(batch)
        if config.population_coef:
            humans = self.policies[diversity.ROLE]
            of_humans = self.policy_params(state.members)[diversity.ROLE]
            batch, logged = diversity.with_bonus(humans, of_humans, batch, hyper)
            metrics |= logged
        members, losses = member_map(self._learn)(state.members, batch, hyper, keys)
        state = dataclasses.replace(state, members=members, update=state.update + 1)
        return state, metrics | losses

    def policy(self, spec: PolicySpec) -> Policy:
        """Return the policy that acts in training for a spec."""
        return self.method.policy(spec)

    def acting(self, state: TrainState) -> dict[str, Params]:
        """Return the parameters that act in the next rollout, by role."""
        progress, params = self._progress(state), self.policy_params(state.members)
        for name, roles in self.learners.items():
            networks = state.members.learners[name].networks
            params |= {r: self.method.acting(params[r], networks, progress) for r in roles}
        return params

    def _progress(self, state: TrainState) -> jax.Array:
        """Return the share of the run that is done []."""
        return state.update.astype(jnp.float32) / self.updates

    def initial_learner(self, roles: tuple[Role, ...], key: jax.Array) -> Learner:
        """Return one member's learner of these roles."""
        actor, critic = jax.random.split(key)
        networks = {
            "actor": self._network(roles).init(actor, self.config.initial_log_std),
            "critic": self._value_network(roles).init(critic),
        }
        networks["actor"].pop("normaliser", None)
        if self.config.latent:
            networks["memory"] = networks["actor"].pop("memory")
        networks |= self.method.init(self.policies[roles[0]], jax.random.fold_in(key, _METHOD))
        start = optimiser(self.config.adam_eps, 1.0)
        return Learner(
            networks=networks,
            optimisers={part: start.init(params) for part, params in networks.items()},
            critic_carry={
                role: self.critics[role].initial_carry((self.config.num_envs,)) for role in roles
            },
        )

    def _learn(
        self, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[MemberState, Metrics]:
        """Return a member after learning from its batch, with updated statistics, and metrics.

        The statistics change only after learning: within an update, probability ratios compare
        policies that read the same normalised observations, and start at exactly 1.
        """
        learners, metrics = {}, {}
        keys = role_keys(key)
        for name, roles in self.learners.items():
            learners[name], losses = self._learn_role(name, member, batch, hyper, keys[roles[0]])
            metrics |= losses
        statistics = member.statistics
        if self.config.normalise:
            # A frozen network needs the normalisation that it learned with.
            learns = self.method.rate("actor", hyper) >= hyper["learning_rate"]
            statistics = jax.tree.map(
                lambda new, old: jnp.where(learns, new, old),
                {name: normaliser.update(old, batch.obs[name]) for name, old in statistics.items()},
                statistics,
            )
        return MemberState(learners, statistics, member.key), metrics

    def _learn_role(
        self, name: str, member: MemberState, batch: Batch, hyper: Hyper, key: jax.Array
    ) -> tuple[Learner, Metrics]:
        """Return a role's or the shared learner after learning from a batch, and metrics."""
        learner = member.learners[name]
        samples, carries, critic_carry, explained = {}, {}, {}, {}
        noise = jax.random.fold_in(key, _METHOD)
        for role in self.learners[name]:
            critic_carry[role], samples[role] = self._samples(
                role, member, learner, batch, hyper, noise
            )
            carries[role] = (batch.carry[role], learner.critic_carry[role])
            advantage, target = samples[role].advantage, samples[role].target
            explained[f"explained_variance_{role}"] = 1.0 - jnp.var(advantage) / (
                jnp.var(target) + 1e-8
            )
        learner, losses = self._descend(name, member, samples, carries, hyper, key)
        return dataclasses.replace(learner, critic_carry=critic_carry), losses | explained

    def _samples(
        self,
        role: str,
        member: MemberState,
        learner: Learner,
        batch: Batch,
        hyper: Hyper,
        key: jax.Array,
    ) -> tuple[Carry, Samples]:
        """Return the critic's carry after the batch, and the role's samples."""
        obs, final_obs, last_obs, extra = self._critic_inputs(role, member, learner, batch, key)
        params = self._critic_params(role, learner.networks["critic"])
        critic = self.critics[role], params, learner.critic_carry[role]
        seen = obs, batch.first, batch.truncated, final_obs, last_obs, batch.last_first
        carry, value, next_value = gae.values(*critic, *seen)
        paid, ends = (batch.reward, value, next_value), (batch.terminated, batch.truncated)
        advantage = gae.advantages(*paid, *ends, hyper["gamma"], hyper["gae_lambda"])
        return carry, Samples(
            obs=batch.obs[role],
            critic_obs=obs,
            first=batch.first,
            raw=batch.raw[role],
            log_prob=batch.log_prob[role],
            advantage=advantage,
            target=advantage + value,
            beside=beside(self.sees, batch.obs, self.normalisers(member)),
            partner=batch.partner,
            **extra,
        )

    def _critic_inputs(
        self, role: str, member: MemberState, learner: Learner, batch: Batch, key: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array, dict[str, jax.Array]]:
        """Return the critic's inputs acted on, at time limits and last, and extra sample fields."""
        everything = batch.obs, batch.tally.final_obs, batch.last_obs
        name, extra, stats = self.critic_obs[role], {}, self.normalisers(member)
        parts: list[Any] = [
            tuple(normalise(stats[name], obs[name]) if stats else obs[name] for obs in everything)
        ]
        parts += [tuple(obs[name] for obs in everything) for name in self.method.critic_sees]
        if self.config.latent:
            params = self.actor(role, member, learner.networks)
            made = latents(self.policies[role], params, role, batch)
            parts.append(made)
            extra["latent"] = made.acted
            extra["noise"] = jax.random.normal(key, made.acted.shape)
        obs, final, last = (jnp.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
        return obs, final, last, extra

    def _descend(
        self,
        name: str,
        member: MemberState,
        samples: dict[str, Samples],
        carries: dict[str, tuple[Carry, Carry]],
        hyper: Hyper,
        key: jax.Array,
    ) -> tuple[Learner, Metrics]:
        """Return a learner after a step for each minibatch of each epoch, and mean losses."""
        config = self.config
        clipped = optimiser(config.adam_eps, hyper["max_grad_norm"])

        def step(learner: Learner, rows: jax.Array) -> tuple[Learner, Metrics]:
            part, starts = taken(samples, rows, 1), taken(carries, rows, 0)
            gradients, losses = jax.grad(self._loss, has_aux=True)(
                learner.networks, member, part, starts, hyper
            )
            for network in learner.networks:
                gradient = gradients[network]
                losses[f"{network}_grad_norm_{name}"] = optax.tree.norm(gradient)
                rate = self.method.rate(network, hyper)
                learner = descended(learner, network, gradient, clipped, rate)
            return learner, losses

        learner, losses = jax.lax.scan(step, member.learners[name], minibatches(key, config))
        return learner, jax.tree.map(jnp.mean, losses)

    def _loss(
        self,
        networks: dict[str, Params],
        member: MemberState,
        samples: dict[str, Samples],
        carries: dict[str, tuple[Carry, Carry]],
        hyper: Hyper,
    ) -> tuple[jax.Array, Metrics]:
        """Return the loss, its mean over roles if they share networks, and metrics to log."""
        loss, metrics = jnp.zeros(()), {}
        for role, part in samples.items():
            actor = self.actor(role, member, networks)
            critic = self._critic_params(role, networks["critic"])
            actor_carry, critic_carry = carries[role]
            policy, valuer = self.policies[role], self.critics[role]
            if self.config.latent:
                gaussian = policy.given(actor, part.obs, self.method.latent(networks, part))
                _, value = unroll_critic(valuer, critic, critic_carry, part.critic_obs, part.first)
            else:
                params, seen = (actor, critic), (part.obs, part.critic_obs)
                gaussian, value = unroll_both(
                    policy, valuer, params, carries[role], seen, part.first
                )
            role_loss, logged = ppo_loss(gaussian, value, part, hyper)
            method_loss, method_metrics = self.method.loss(
                networks, policy, actor, part, actor_carry
            )
            loss = loss + (role_loss + hyper["aux_coef"] * method_loss) / len(samples)
            metrics |= {
                f"{name}_{role}": value for name, value in (logged | method_metrics).items()
            }
        return loss, metrics

    def _network(self, roles: tuple[str, ...]) -> Policy:
        """Return the network to initialise: a role's own, or the one that roles share."""
        if len(roles) == 1:
            return self.policies[roles[0]]
        return Policy(shared_network.shared_spec([self.specs[role] for role in roles]))

    def _value_network(self, roles: tuple[str, ...]) -> Critic:
        """Return the critic to initialise: a role's own, or the one that roles share."""
        if len(roles) == 1:
            return self.critics[roles[0]]
        sizes = {role: self.critics[role].spec.observation_size for role in roles}
        return self.critic(shared_network.padded_size(sizes))

    def critic(self, width: int) -> Critic:
        """Return a critic for inputs of a width."""
        return self.method.critic(super().critic(width).spec)

    def critic_width(self, role: str) -> int:
        """Return the width of a role's critic inputs."""
        more = (self.env.observation_size[name] for name in self.method.critic_sees)
        return super().critic_width(role) + sum(more) + self.config.latent

    def actor(self, role: str, member: MemberState, networks: Mapping[str, Params]) -> Params:
        """Return a role's ordinary parameters; leading axes of the leaves are free."""
        if self.config.shared:
            spec, shared = self.specs[role], networks["actor"]
            folded = shared_network.fold(shared, role, spec.observation_size, spec.action_size)
            networks = {**networks, "actor": folded}
        params = super().actor(role, member, networks)
        return {**params, "memory": networks["memory"]} if self.config.latent else params

    def _critic_params(self, role: str, params: Params) -> Params:
        """Return the ordinary parameters of a role's critic."""
        if not self.config.shared:
            return params
        return shared_network.fold(params, role, self.critics[role].spec.observation_size)
