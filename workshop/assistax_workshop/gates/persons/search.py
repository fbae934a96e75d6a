"""Search over the numbers of a task's script, for the return of a tuned script.

The cross-entropy method: rounds of tries, each drawn about the best fifth of the round before. All
tries of a round play the same episodes, side by side in one program.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.preferences import PREFERRED
from assistax_envs.tasks.chain import SCRIPTS
from assistax_workshop.gates.persons.play import (
    Plan,
    about,
    play_persons,
    play_strangers,
    rollout_with_persons,
    training_persons,
)
from assistax_workshop.gates.persons.scripts import TriedScript, own_numbers, script_env

ROUNDS = 5
ELITE = 5  # one try in this many is a model of the next round
FIRST, LEAST = 0.2, 0.03  # spread of the first round, and least spread, as shares of a range
# Of a script that is told: shares of the liked force and speed that it keeps to.
HEEDING = {"heed": (0.4, 1.3), "pace": (0.5, 3.0)}
DRAWN = 0.4  # share of the first round that is drawn uniformly from the ranges


def search_script(
    plan: Plan, progress: Callable[[str], None] = print, told: bool = False, idle: bool = False
) -> dict[str, Any]:
    """Return the best numbers found with persons of the training side, and their results.

    Args:
        plan: The plan.
        progress: Called with a line after each round.
        told: Whether the script is told the wishes.
        idle: Whether the persons are idle.

    Raises:
        ValueError: There are too few tries for the rounds.
    """
    if plan.tries < ROUNDS * ELITE:
        raise ValueError(f"tries is {plan.tries}; give at least {ROUNDS * ELITE}")
    env, names = script_env(plan, told), list(ranges(plan.task, told))
    rng = np.random.default_rng(0)
    rollout = rollout_with_persons(plan, env, TriedScript(env, told), idle)
    met = training_persons(plan.models)
    at, spread = _own_places(plan.task, told), np.full(len(names), FIRST)
    tried: list[tuple[float, np.ndarray]] = []
    for turn in range(ROUNDS):
        places = rng.normal(at, spread, (plan.tries // ROUNDS, len(names)))
        if turn == 0:
            anywhere = round(DRAWN * len(places))
            places[:anywhere] = rng.uniform(size=(anywhere, len(names)))
            places[0] = at  # the script as it is
        places = np.clip(places, 0.0, 1.0)
        earned = play_persons(rollout, plan.task, _stack(plan.task, places, told), met, 1)
        scores = np.mean(earned["return"], axis=(1, 2))
        tried += zip(scores.tolist(), places, strict=True)
        best = sorted(tried, key=lambda one: -one[0])[: len(places) // ELITE]
        chosen = np.array([place for _, place in best])
        at, spread = chosen.mean(axis=0), np.maximum(chosen.std(axis=0), LEAST)
        progress(f"search, round {turn + 1} of {ROUNDS}: best {best[0][0]:.1f}")
    # The best of one round of few persons is good by chance, too: the mean of the last models.
    places = np.stack([at, tried[0][1]])  # and the script as it is
    stack = _stack(plan.task, places, told)
    return {
        "about": about(plan, env) | {"tries": plan.tries, "persons": met.tolist()},
        "numbers": {name: float(values[0]) for name, values in stack.items()},
        "scores": [score for score, _ in tried],  # the first is of the script as it is
        "sides": play_strangers(rollout, plan, stack),  # of the best, then of the script as it is
    }


def ranges(task: str, told: bool = False) -> dict[str, tuple[float, float]]:
    """Return the least and largest value that a search tries of each number.

    A script that is told has no numbers of its own in place of wishes.
    """
    script = SCRIPTS[task]
    if not told or script.told is None:
        return dict(script.ranges)
    wishes = dict.fromkeys(PREFERRED[task], jnp.ones((1, 1)))
    of_wishes = script.told(own_numbers(task, told), wishes)
    own = {name: ends for name, ends in script.ranges.items() if name not in of_wishes}
    return own | {name: ends for name, ends in HEEDING.items() if name in script.careful}


def _own_places(task: str, told: bool) -> np.ndarray:
    """Return the script's own numbers as shares of their ranges."""
    numbers = own_numbers(task, told)
    places = [(numbers[n] - low) / (high - low) for n, (low, high) in ranges(task, told).items()]
    return np.clip(places, 0.0, 1.0)


def _stack(task: str, places: np.ndarray, told: bool) -> dict[str, jax.Array]:
    """Return the numbers by name, [tries] each, for shares of their ranges [tries, numbers]."""
    ends = ranges(task, told)
    low, high = np.array(list(ends.values())).T
    values = low + places * (high - low)
    columns = np.array([[float(f"{value:.4g}") for value in row] for row in values], np.float32)
    return dict(zip(ends, jnp.asarray(columns.T), strict=True))
