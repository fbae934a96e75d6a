"""Self-play of trained teams: the return of each robot with its own human, both deterministic."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from population.networks.members import flatten, member_map, split
from population.networks.policy import Params, Policy
from population.trainers.environment import Environment

_RESAMPLES = 2000
_LEVEL = 95.0


def self_play(
    env: Environment,
    policies: Mapping[str, Policy],
    params: Mapping[str, Params],
    env_params: Any,
    keys: jax.Array,
    episodes: int,
) -> list[dict[str, Any]]:
    """Play episodes of every team and return `mean`, `iqm`, `mean_ci`, `n` and `success` of each.

    The interval is a percentile bootstrap over a team's episodes: it says how well these episodes
    determine this team's return, and nothing about other seeds.

    Args:
        env: The environment.
        policies: Networks by role.
        params: Their parameters, leaves [M, ...].
        env_params: Parameters of the environment, one for each team [M].
        keys: One key for each team [M].
        episodes: K, episodes of each team.
    """
    returns, success = jax.jit(partial(_play, env, policies, episodes=episodes))(
        params, env_params, keys
    )
    returns, success = np.asarray(returns, np.float64), np.asarray(success)
    return [_figures(*team) for team in zip(returns, success, strict=True)]


def _play(
    env: Environment,
    policies: Mapping[str, Policy],
    params: Mapping[str, Params],
    env_params: Any,
    keys: jax.Array,
    *,
    episodes: int,
) -> tuple[jax.Array, jax.Array]:
    """Return the returns [M, K] and whether the goal ever held [M, K]."""
    teams = keys.shape[0]
    flat_keys = jax.vmap(lambda key: jax.random.split(key, episodes))(keys).reshape(-1)
    state = env.reset(
        flat_keys, jax.tree.map(lambda leaf: jnp.repeat(leaf, episodes, axis=0), env_params)
    )
    carry = {role: policy.initial_carry((teams, episodes)) for role, policy in policies.items()}
    false = jnp.zeros(teams * episodes, bool)

    def act(
        params: Any, carry: Any, obs: Any, first: jax.Array
    ) -> tuple[dict[str, Any], dict[str, jax.Array]]:
        acted = {
            role: policies[role].act(params[role], carry[role], obs[role], first)
            for role in policies
        }
        return {role: pair[0] for role, pair in acted.items()}, {
            role: pair[1] for role, pair in acted.items()
        }

    def step(loop: Any, time: jax.Array) -> tuple[Any, None]:
        state, carry, running, returns, success = loop
        obs = {role: state.obs[role] for role in policies}
        first = jnp.full((teams, episodes), time == 0)
        carry, action = member_map(act)(params, carry, split(obs, teams), first)
        state = env.step(state, flatten(action))
        earning = running & ~state.nonfinite
        returns = returns + jnp.where(earning, state.reward, 0.0)
        success = success | (earning & state.measures.success)
        running = running & ~(state.terminated | state.truncated)
        return (state, carry, running, returns, success), None

    loop = (state, carry, ~false, jnp.zeros(teams * episodes), false)
    (_, _, _, returns, success), _ = jax.lax.scan(step, loop, jnp.arange(env.episode_length))
    return returns.reshape(teams, episodes), success.reshape(teams, episodes)


def _figures(returns: np.ndarray, success: np.ndarray) -> dict[str, Any]:
    from scipy import stats  # half a second, hence not at every start

    rows = np.random.default_rng(0).integers(len(returns), size=(_RESAMPLES, len(returns)))
    tail = (100.0 - _LEVEL) / 2.0
    low, high = np.percentile(returns[rows].mean(axis=1), [tail, 100.0 - tail])
    return {
        "mean": float(returns.mean()),
        "iqm": float(stats.trim_mean(returns, 0.25)),
        "mean_ci": [float(low), float(high)],
        "n": len(returns),
        "success": float(success.mean()),
    }
