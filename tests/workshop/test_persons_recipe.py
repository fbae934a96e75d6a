"""The recipe with persons judges the robot's acts although its critic does not see the person.

Half of the persons want the spoon, and half do not. A robot waits, or pushes the spoon in. The
spoon comes to the mouth of each person that wants it, and to the others' only if it is pushed. A
spoon in the mouth earns 1 after a while if the person wants it, else -1. So waiting earns 0.5 and
pushing 0. A critic that sees the spoon alone values a mouth by its visitors, who mostly want the
spoon.
"""

import jax.numpy as jnp
import numpy as np
import pytest

from assistax_workshop.gates.persons.robots import WITH_PERSONS, recipe_with_persons
from population.trainers.gae import advantages

PUSHES, STAY = 0.1, 60  # share of pushes among the robot's acts, steps in the mouth
WANTS, PUSHED = np.array([1, 0, 1, 0]), np.array([0, 0, 1, 1])  # of the four kinds of episodes
SHARE = np.where(PUSHED, PUSHES, 1 - PUSHES) / 2
INSIDE = (WANTS | PUSHED).astype(bool)
EARNED = np.where(INSIDE, np.where(WANTS, 1.0, -1.0), 0.0)


def preferred_act(gae_lambda: float) -> str:
    """Return the act with the higher mean advantage, by the exact values of what is seen."""
    inside = np.average(EARNED[INSIDE], weights=SHARE[INSIDE])
    start = np.average(EARNED, weights=SHARE)
    value = np.concatenate([[np.full(4, start)], np.tile(np.where(INSIDE, inside, 0.0), (STAY, 1))])
    reward = np.zeros_like(value)
    reward[-1] = EARNED
    ended = np.zeros(value.shape, bool)
    ended[-1] = True
    after = np.concatenate([value[1:], np.zeros((1, 4))])
    chunk = map(jnp.asarray, (reward, value, after, ended, np.zeros_like(ended)))
    first = np.asarray(advantages(*chunk, 1.0, gae_lambda))[0]
    means = [np.average(first[act == PUSHED], weights=SHARE[act == PUSHED]) for act in (0, 1)]
    return ("wait", "push")[int(np.argmax(means))]


@pytest.mark.parametrize("task", ["gentle_feeding", "gentle_scratch"])
def test_recipe_with_persons_prefers_to_wait(task: str) -> None:
    recipe = recipe_with_persons(task)
    assert preferred_act(recipe["gae_lambda"]) == "wait"
    # A cut rollout ends in the critic's value too.
    assert recipe["rollout_steps"] > 2 * STAY
    assert recipe["rollout_steps"] * recipe["num_envs"] == 65_536
    assert recipe["num_envs"] % recipe["minibatches"] == 0


def test_shorter_traces_prefer_to_push() -> None:
    assert [preferred_act(decay) for decay in (0.0, 0.95, 1.0)] == ["push", "push", "wait"]


def test_task_without_a_recipe_keeps_the_preset() -> None:
    assert recipe_with_persons("scratch") == {"learning_rate": 5e-4, **WITH_PERSONS}
