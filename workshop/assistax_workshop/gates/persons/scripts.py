"""Scripts with persons: the task's own, with tried numbers, and told the wishes or multiples."""

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, make
from assistax_envs.tasks.chain import SCRIPTS, observed_wishes, script_of, told_script_of
from assistax_workshop.gates.persons.play import (
    SINGLE,
    SINGLE_EPISODES,
    Plan,
    about,
    play_persons,
    play_strangers,
    rollout_with_persons,
)

CAREFUL = "told-script"  # stage of the script that is told the wishes, and its name
FACTORS = (1.0, 1.5, 2.0, 3.0)  # multiples of the liked values that a told script keeps to


class TriedScript:
    """Policy that plays a task's script with given numbers.

    Args:
        env: The environment; its robot is told the wishes if the script is.
        told: Whether the script keeps to wishes: "factor" times those that it observes.
    """

    def __init__(self, env: Env, told: bool = False) -> None:
        self._env, self._told = env, told

    def initial_carry(self, batch_shape: tuple[int, ...]) -> tuple[()]:
        """Return the empty carry."""
        return ()

    def act(
        self, params: Mapping[str, jax.Array], carry: tuple[()], obs: jax.Array, first: jax.Array
    ) -> tuple[tuple[()], jax.Array]:
        """Return actions [..., 7] for obs [..., O], by the script's numbers `params`, [] each."""
        numbers, flat = dict(params), obs.reshape(-1, obs.shape[-1])
        factor = numbers.pop("factor", 1.0)
        task, model = self._env.task, self._env.model
        if self._told:
            wishes = factor * observed_wishes(task, flat)
            action = told_script_of(task, model, numbers)(flat, wishes)
        else:
            action = script_of(task, model, numbers)(flat)
        return carry, action.reshape(*obs.shape[:-1], -1)


def script_env(plan: Plan, told: bool = False) -> Env:
    """Return the environment of a script; its robot is told the wishes if the script is."""
    return make(plan.task, plan.backend, told=("human", "robot") if told else ("human",))


def own_numbers(task: str, told: bool = False) -> dict[str, float]:
    """Return the numbers of a task's script, or of the script that is told the wishes."""
    script = SCRIPTS[task]
    return {**script.numbers, **(script.careful if told else {})}


def play_script(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return the script's results with strangers, and with the persons of best responses."""
    return _played(plan, {"factor": [1.0]}, told=False)


def play_told(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return the results of the script that is told multiples of the wishes: one a robot."""
    found = _played(plan, {"factor": FACTORS}, told=True)
    for side, figures in found["sides"].items():
        means = np.mean(figures["return"], axis=(1, 2))
        progress(
            f"{CAREFUL} with {side}: return "
            + ", ".join(f"{mean:.1f} at {f:g}" for f, mean in zip(FACTORS, means, strict=True))
        )
    return found


def _played(plan: Plan, numbers: Mapping[str, Any], told: bool) -> dict[str, Any]:
    env = script_env(plan, told)
    stack = {name: jnp.asarray(values, jnp.float32) for name, values in numbers.items()}
    rollout = rollout_with_persons(plan, env, TriedScript(env, told))
    met = np.array(plan.sample)
    sides = {SINGLE: play_persons(rollout, plan.task, stack, met, SINGLE_EPISODES)}
    return {"about": about(plan, env), "sides": sides | play_strangers(rollout, plan, stack)}
