"""Collection of a chunk of experience from all simulations of all members."""

import dataclasses
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from assistax_envs import select
from population.environment import Environment, EnvState
from population.networks.members import member_map, to_members, to_simulations
from population.networks.policy import Gaussian, Policy
from population.networks.seat import Carry, Params
from population.partners.frozen import FrozenPartners

EVER = ("success", "violated")  # measures that are true of an episode if true at any step
STEP, FASTEST = 0.02, 20.0  # s, a control step; rad/s, beyond which a joint's speed is cut
Sampler = Callable[[Gaussian, jax.Array], jax.Array]  # draws raw actions with a key


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Episodes:
    """Episodes in progress.

    An episode whose first step was not simulated is not `whole`, and is never counted.
    """

    whole: jax.Array  # [N] bool
    sums: dict[str, jax.Array]  # so far [N]: "return", "term_...", and 0 or 1 for each of EVER


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Simulations:
    """State of all simulations of all members between two steps."""

    env: EnvState
    carry: dict[str, Carry]  # of the actors, by role [M, N/M, ...]
    partners: Carry  # carries of frozen partners; () without any
    # Whether the current observation starts an episode, or a series if there are any [N].
    first: jax.Array
    episodes: Episodes
    series: Any = ()  # `Series`, if robots remember their partner over several episodes


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Series:
    """Position of simulations in their series of episodes with one partner and preference."""

    turn: jax.Array  # [N] int32, the episode of the series
    begins: jax.Array  # [N] bool, the current observation starts an episode


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Tally:
    """Results of the simulations in a chunk."""

    final_obs: dict[str, jax.Array]  # at a simulation's time limit, before its reset [N, O]
    finished: jax.Array  # number of whole episodes that ended [N]
    finished_sums: dict[str, jax.Array]  # over them, of what `Episodes.sums` has [N]
    nonfinite: jax.Array  # number of simulations that diverged [N]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Batch:
    """Chunk of T steps of N simulations; for one member, N is its share."""

    carry: dict[str, Carry]  # of the actors at the start of the chunk, by role
    obs: dict[str, jax.Array]  # [T, N, O] acted on, by role and "global"
    first: jax.Array  # [T, N]
    raw: dict[str, jax.Array]  # raw actions [T, N, A], by role
    log_prob: dict[str, jax.Array]  # of the raw actions [T, N], by role
    reward: jax.Array  # [T, N]
    # [T, N]; true for a diverged simulation too, whose later rewards are 0.
    terminated: jax.Array
    truncated: jax.Array  # [T, N]
    last_obs: dict[str, jax.Array]  # after the chunk [N, O]
    last_first: jax.Array  # [N]
    tally: Tally
    partner: Any = ()  # [T, N, A + J] the partner's actions and joint speeds, rad/s, if watched


def begin(
    env: EnvState,
    policies: Mapping[str, Policy],
    members: int,
    stagger: jax.Array,
    partners: FrozenPartners | None = None,
    series: int = 1,
) -> Simulations:
    """Return simulations at the states of `env`, their step counters set to `stagger` [N].

    Staggered episodes reach their time limits at different steps, so that every batch holds all
    phases of an episode, and of a series.
    """
    simulations = stagger.shape[0]
    return Simulations(
        env=dataclasses.replace(env, step=stagger.astype(env.step.dtype)),
        carry={
            role: policy.initial_carry((members, simulations // members))
            for role, policy in policies.items()
        },
        partners=partners.initial_carry(simulations) if partners else (),
        first=jnp.ones(simulations, bool),
        episodes=Episodes(whole=stagger == 0, sums=jax.tree.map(jnp.zeros_like, _gains(env))),
        series=Series(jnp.arange(simulations) % series, jnp.ones(simulations, bool))
        if series > 1
        else (),
    )


def collect(
    env: Environment,
    policies: Mapping[str, Policy],
    params: Mapping[str, Params],
    keys: jax.Array,
    state: Simulations,
    fresh: EnvState,
    inputs: tuple[str, ...],
    partners: FrozenPartners | None = None,
    partner_params: Any = (),
    sample: Sampler = Gaussian.sample,
    watched: bool = False,
    series: int = 1,
) -> tuple[Simulations, Batch]:
    """Return the simulations after T steps, and the experience; ended episodes restart.

    Args:
        env: The environment.
        policies: Networks by role.
        params: Their parameters, leaves [M, ...].
        keys: Keys of the actions [T, M].
        state: The simulations.
        fresh: Reset states [N]; at most one is needed each, as T must not exceed an episode.
        inputs: Names of the observations that the learners read.
        partners: Partners that act in the role without a policy.
        partner_params: Their parameters.
        sample: Sampler of raw actions.
        watched: Whether the batch holds the partner's actions and speeds.
        series: Episodes of one series; inner episode ends are not marked as ends.
    """
    members = keys.shape[1]
    act = member_map(partial(_act, policies, sample))

    def step(loop: _Loop, keys: jax.Array) -> tuple[_Loop, dict[str, Any]]:
        state, tally = loop
        obs = to_members({r: _read(p, r, state.env.obs) for r, p in policies.items()}, members)
        carry, acted = act(params, state.carry, obs, to_members(state.first, members), keys)
        action, raw, log_prob = to_simulations(acted)
        partner_carry = state.partners
        if partners:
            partner_carry, action[partners.role] = _play(partners, partner_params, state, members)
            said = partners.words(partner_carry, members)
            action |= {} if said is None else {"word": said}
        after = env.step(state.env, action)
        terminated, truncated, ended = _ends(after)
        episodes, tally = _account(state.episodes, tally, after, ended, truncated)
        record = {"obs": {name: state.env.obs[name] for name in inputs}, "first": state.first}
        record |= {"raw": raw, "log_prob": log_prob, "reward": after.reward}
        record |= {"terminated": terminated, "truncated": truncated}
        if watched and partners:
            record["partner"] = _watched(env, partners.role, action, state.env, after)
        after, diverged = select(ended, fresh, after), after.nonfinite
        state = Simulations(after, carry, partner_carry, ended, episodes, state.series)
        if series > 1:
            state, record = _in_series(state, diverged, record, series)
        return (state, tally), record

    (after, tally), seen = jax.lax.scan(step, (state, _empty_tally(state, inputs)), keys)
    return after, _batch(state, after, tally, seen, inputs)


def _batch(
    before: Simulations,
    after: Simulations,
    tally: Tally,
    steps: dict[str, Any],
    inputs: tuple[str, ...],
) -> Batch:
    """Return the experience between two states, of records of its steps [T, N, ...] by name."""
    return Batch(
        carry=to_simulations(before.carry),
        **steps,
        last_obs={name: after.env.obs[name] for name in inputs},
        last_first=after.first,
        tally=tally,
    )


def by_member(batch: Batch, members: int) -> Batch:
    """Return a batch with the member axis in front: leaves [T, N, ...] become [M, T, N/M, ...]."""

    def over_time(leaf: jax.Array) -> jax.Array:
        return jnp.moveaxis(leaf.reshape(leaf.shape[0], members, -1, *leaf.shape[2:]), 1, 0)

    timed = ("obs", "first", "raw", "log_prob", "reward", "terminated", "truncated", "partner")
    return Batch(
        **{
            name: jax.tree.map(over_time, value) if name in timed else to_members(value, members)
            for name, value in vars(batch).items()
        }
    )


def episode_metrics(batch: Batch) -> dict[str, jax.Array]:
    """Return means over the whole episodes that ended (NaN if there are none), and counts."""
    tally, finished = batch.tally, batch.tally.finished.sum()
    means = {name: value.sum() / finished for name, value in tally.finished_sums.items()}
    return {
        **means,
        "episodes": finished,
        "reward": batch.reward.mean(),
        "nonfinite": tally.nonfinite.sum(),
    }


_Loop = tuple[Simulations, Tally]


def _ends(after: EnvState) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return three masks [N]: terminated (or diverged), at the time limit, and either of them."""
    terminated = after.terminated | after.nonfinite
    return terminated, after.truncated & ~terminated, terminated | after.truncated


def _play(
    partners: FrozenPartners, params: Any, state: Simulations, members: int
) -> tuple[Carry, jax.Array]:
    """Return the partners' carries and actions [N, A]; carries are reset with every episode."""
    obs, humans = state.env.obs[partners.role], state.env.params
    first = state.series.begins if state.series else state.first
    return partners.act(params, state.partners, obs, first, members, humans)


def _in_series(
    state: Simulations, diverged: jax.Array, record: dict[str, Any], series: int
) -> tuple[Simulations, dict[str, Any]]:
    """Return state and record in which the inner ends of a series are not marked as ends."""
    ended, before = state.first, state.series
    continues = ended & (before.turn < series - 1) & ~diverged
    turn = jnp.where(continues, before.turn + 1, jnp.where(ended, 0, before.turn))
    state = dataclasses.replace(state, first=ended & ~continues, series=Series(turn, ended))
    return state, {**record, **{n: record[n] & ~continues for n in ("terminated", "truncated")}}


def _empty_tally(state: Simulations, inputs: tuple[str, ...]) -> Tally:
    """Return a tally of zeros."""
    zeros = partial(jax.tree.map, jnp.zeros_like)
    count = jnp.zeros(state.first.shape, jnp.int32)
    final_obs = zeros({name: state.env.obs[name] for name in inputs})
    return Tally(final_obs, count, zeros(state.episodes.sums), count)


def _act(
    policies: Mapping[str, Policy],
    sample: Sampler,
    params: dict[str, Params],
    carries: dict[str, Carry],
    obs: dict[str, jax.Array],
    first: jax.Array,
    key: jax.Array,
) -> tuple[
    dict[str, Carry], tuple[dict[str, jax.Array], dict[str, jax.Array], dict[str, jax.Array]]
]:
    """Return one member's carries, and by role its actions, raw actions and log probabilities."""
    carry, action, raw, log_prob = {}, {}, {}, {}
    for role, role_key in zip(policies, jax.random.split(key, len(policies)), strict=True):
        after, gaussian = policies[role].step(params[role], carries[role], obs[role], first)
        raw[role] = sample(gaussian, role_key)
        action[role], log_prob[role] = gaussian.action(raw[role]), gaussian.log_prob(raw[role])
        carry[role] = policies[role].acted(after, action[role])
    return carry, (action, raw, log_prob)


def _read(policy: Policy, role: str, obs: dict[str, jax.Array]) -> jax.Array:
    """Return a policy's input [N, O]: the observation of its role, and those in `beside`."""
    if not policy.beside:
        return obs[role]
    return jnp.concatenate([obs[role], *(obs[name] for name in policy.beside)], axis=-1)


def _watched(
    env: Environment, role: str, action: dict[str, jax.Array], before: EnvState, after: EnvState
) -> jax.Array:
    """Return a role's action and joint speeds in a step [N, A + J]; NaN speeds become 0."""
    start, end = (env.joint_positions(state)[role] for state in (before, after))
    speed = jnp.clip((end - start) / STEP, -FASTEST, FASTEST)
    return jnp.concatenate([jnp.clip(action[role], -1.0, 1.0), jnp.nan_to_num(speed)], axis=-1)


def _gains(state: EnvState) -> dict[str, jax.Array]:
    """Return the increments [N] of a step by name; measures that the task lacks are left out."""
    ever = {name: getattr(state.measures, name, None) for name in EVER}
    return {
        "return": state.reward,
        **{f"term_{name}": value for name, value in state.terms.items()},
        **{name: value.astype(jnp.float32) for name, value in ever.items() if value is not None},
    }


def _account(
    episodes: Episodes, tally: Tally, after: EnvState, ended: jax.Array, truncated: jax.Array
) -> tuple[Episodes, Tally]:
    """Return the episodes in progress after a step, and the tally with those that ended."""
    sums = {
        name: jnp.maximum(episodes.sums[name], gain) if name in EVER else episodes.sums[name] + gain
        for name, gain in _gains(after).items()
    }
    counted = ended & episodes.whole
    tally = Tally(
        final_obs=select(
            truncated, {name: after.obs[name] for name in tally.final_obs}, tally.final_obs
        ),
        finished=tally.finished + counted,
        finished_sums={
            name: tally.finished_sums[name] + jnp.where(counted, sums[name], 0.0) for name in sums
        },
        nonfinite=tally.nonfinite + after.nonfinite,
    )
    sums = {name: jnp.where(ended, 0.0, value) for name, value in sums.items()}
    return Episodes(whole=episodes.whole | ended, sums=sums), tally
