"""Self-play of trained teams: the return of each robot with its own human, both deterministic."""

from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from assistax_base.statistics import iqm
from population.environment import Environment
from population.networks.policy import Policy
from population.networks.seat import Params
from population.play.rollout import Rollout

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
    """Return `mean`, `iqm`, `mean_ci`, `n` and `success` of episodes of every team.

    The interval is a percentile bootstrap over a team's episodes: it describes the precision of
    this team's return, not the spread between seeds.

    Args:
        env: The environment.
        policies: Networks by role.
        params: Their parameters, leaves [M, ...].
        env_params: Parameters of the environment, one for each team [M].
        keys: One key for each team [M].
        episodes: K, episodes of each team.
    """
    rollout = Rollout(env, [policies["robot"]], [policies["human"]], paired=True)
    starts = jax.vmap(lambda key: jax.random.split(key, episodes))(keys)  # [M, K]
    tally = rollout.run([params["robot"]], [params["human"]], env_params, starts)
    returns, success = np.asarray(tally.returns[0], np.float64), np.asarray(tally.success[0])
    return [_figures(*team) for team in zip(returns, success, strict=True)]


def _figures(returns: np.ndarray, success: np.ndarray) -> dict[str, Any]:
    """Return the figures of one team's episodes."""
    rows = np.random.default_rng(0).integers(len(returns), size=(_RESAMPLES, len(returns)))
    tail = (100.0 - _LEVEL) / 2.0
    low, high = np.percentile(returns[rows].mean(axis=1), [tail, 100.0 - tail])
    return {
        "mean": float(returns.mean()),
        "iqm": iqm(returns),
        "mean_ci": [float(low), float(high)],
        "n": len(returns),
        "success": float(success.mean()),
    }
