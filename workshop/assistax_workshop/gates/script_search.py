"""Search over the numbers of a task's script, for the return of a tuned script.

The cross-entropy method: rounds of tries, each drawn about the best fifth of the round before. All
tries of a round play the same episodes, side by side in one program.
"""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, make
from assistax_envs.persons import numbers
from assistax_envs.tasks.chain import SCRIPTS, script_of
from assistax_workshop.gates.persons_play import (
    STRANGERS,
    Plan,
    about,
    play_persons,
    play_strangers,
    rollout_with_persons,
)

ROUNDS = 5
ELITE = 5  # one try in this many is a model of the next round
FIRST, LEAST = 0.2, 0.03  # spread of the first round, and least spread, as shares of a range
DRAWN = 0.4  # share of the first round that is drawn uniformly from the ranges


class TriedScript:
    """Policy that plays a task's script with given numbers."""

    def __init__(self, env: Env) -> None:
        self._env = env

    def initial_carry(self, batch_shape: tuple[int, ...]) -> tuple[()]:
        """Return the empty carry."""
        return ()

    def act(
        self, params: Mapping[str, jax.Array], carry: tuple[()], obs: jax.Array, first: jax.Array
    ) -> tuple[tuple[()], jax.Array]:
        """Return actions [..., 7] for obs [..., O], by the script's numbers `params`, [] each."""
        robot = script_of(self._env.task, self._env.model, params)
        return carry, robot(obs.reshape(-1, obs.shape[-1])).reshape(*obs.shape[:-1], -1)


def search_script(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return the best numbers found with persons of the training side, and their results.

    Raises:
        ValueError: There are too few tries for the rounds.
    """
    if plan.tries < ROUNDS * ELITE:
        raise ValueError(f"tries is {plan.tries}; give at least {ROUNDS * ELITE}")
    env, names = make(plan.task, plan.backend), list(SCRIPTS[plan.task].ranges)
    policy, rng = TriedScript(env), np.random.default_rng(0)
    rollout = rollout_with_persons(plan, env, policy)
    training = numbers("training")
    met = training[:: len(training) // plan.models][: plan.models]
    at, spread = _own_places(plan.task), np.full(len(names), FIRST)
    tried: list[tuple[float, np.ndarray]] = []
    for turn in range(ROUNDS):
        places = rng.normal(at, spread, (plan.tries // ROUNDS, len(names)))
        if turn == 0:
            anywhere = round(DRAWN * len(places))
            places[:anywhere] = rng.uniform(size=(anywhere, len(names)))
            places[0] = at  # the script as it is
        places = np.clip(places, 0.0, 1.0)
        earned = play_persons(rollout, plan.task, _stack(plan.task, places), met, 1)
        scores = np.mean(earned["return"], axis=(1, 2))
        tried += zip(scores.tolist(), places, strict=True)
        best = sorted(tried, key=lambda one: -one[0])[: len(places) // ELITE]
        chosen = np.array([place for _, place in best])
        at, spread = chosen.mean(axis=0), np.maximum(chosen.std(axis=0), LEAST)
        progress(f"search, round {turn + 1} of {ROUNDS}: best {best[0][0]:.1f}")
    places = np.stack([best[0][1], tried[0][1]])  # the best, and the script as it is
    stack = _stack(plan.task, places)
    sides = {side: play_strangers(plan, env, policy, stack, side) for side in STRANGERS}
    return {
        "about": about(plan, env) | {"tries": plan.tries, "persons": met.tolist()},
        "numbers": {name: float(values[0]) for name, values in stack.items()},
        "scores": [score for score, _ in tried],  # the first is of the script as it is
        "sides": sides,  # of the best, then of the script as it is
    }


def _own_places(task: str) -> np.ndarray:
    """Return the script's own numbers as shares of their ranges."""
    script = SCRIPTS[task]
    return np.array(
        [(script.numbers[n] - low) / (high - low) for n, (low, high) in script.ranges.items()]
    )


def _stack(task: str, places: np.ndarray) -> dict[str, jax.Array]:
    """Return the numbers by name, [tries] each, for shares of their ranges [tries, numbers]."""
    ranges = np.array(list(SCRIPTS[task].ranges.values()))
    values = ranges[:, 0] + places * (ranges[:, 1] - ranges[:, 0])
    columns = np.array([[float(f"{value:.4g}") for value in row] for row in values], np.float32)
    return dict(zip(SCRIPTS[task].ranges, jnp.asarray(columns.T), strict=True))
