"""Causal test of adaptation: the same start and person, with one wish swapped.

The slope of a robot is how far the logarithm of what it does follows that of what is liked, if
nothing else changes: 1 is perfect, 0 is none.
"""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, make
from assistax_envs.persons import persons
from assistax_envs.persons.rows import index
from assistax_envs.preferences import PREFERRED
from assistax_workshop.gates.persons.play import (
    EPISODES,
    Plan,
    play_rows,
    rollout_with_persons,
    rows_of,
    strangers,
)
from assistax_workshop.gates.persons.robots import ROBOTS
from assistax_workshop.gates.persons.scripts import CAREFUL, TriedScript, script_env
from population.play.rollout import Rollout
from population.runs.trained import read_trained_run
from zoo.ids import EGO
from zoo.registry import load_registry

SWAPPED = "corners"  # side whose persons have a wish swapped


def play_swapped(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return the slopes of robots [M] for each wish that is swapped, by kind of robot."""
    slopes = {}
    for name, env, policy, params in players(plan):
        rollout = rollout_with_persons(plan, env, policy)
        slopes[name] = {wish: _slopes(plan, rollout, params, wish) for wish in PREFERRED[plan.task]}
        shown = {wish: float(np.mean(found)) for wish, found in slopes[name].items()}
        progress(f"swapped, {name}: {', '.join(f'{w} {s:.2f}' for w, s in shown.items())}")
    return {"about": {"task": plan.task, "side": SWAPPED}, "slopes": slopes}


def players(plan: Plan) -> Iterator[tuple[str, Env, Any, Any]]:
    """Yield name, environment, policy and parameters of scripts and robots.

    The robots are those of the folder by kind, then those of the registry, by method.
    """
    for name in ("script", CAREFUL):
        env = script_env(plan, name == CAREFUL)
        yield name, env, TriedScript(env, name == CAREFUL), {"factor": jnp.ones(1)}
    for name, kind in ROBOTS.items():
        if name != "best" and (plan.folder / name / "teams.json").exists():
            env = make(plan.task, plan.backend, told=kind.told)
            stack = read_trained_run(plan.folder / name).policies["robot"]
            yield name, env, stack.spec.player(), jax.tree.map(jnp.asarray, stack.params)
    registry = load_registry()
    robots = [e for e in registry.policies if (e.task, e.disability) == (plan.task, EGO)]
    methods = {entry.id: entry.algorithm for entry in robots}
    for stack in registry.stacks(robots):
        name, env = f"published {methods[stack.ids[0]]}", make(plan.task, plan.backend)
        yield name, env, stack.spec.player(), jax.tree.map(jnp.asarray, stack.params)


def swapped(task: str, rows: np.ndarray, wish: str) -> tuple[np.ndarray, np.ndarray]:
    """Return rows [P, 31] of those in the outer thirds of a wish, and the same with it swapped.

    The value that stands as far from one end of all persons' values as theirs from the other.
    """
    column = index(task)[f"liked_{wish}"]
    values = np.sort(persons(task)[:, column])
    place = np.searchsorted(values, rows[:, column]).clip(0, len(values) - 1)
    outer = np.abs(place / len(values) - 0.5) > 1 / 6
    other = rows[outer].copy()
    other[:, column] = values[len(values) - 1 - place[outer]]
    return rows[outer], other


def _slopes(plan: Plan, rollout: Rollout, params: Any, wish: str) -> list[float]:
    """Return the slope of each robot by least squares through zero, over persons and episodes."""
    both = swapped(plan.task, rows_of(plan.task, strangers(SWAPPED)), wish)
    played = [play_rows(rollout, plan.task, params, rows, EPISODES) for rows in both]
    liked, done = (
        np.log(np.asarray(played[1][f"{what}_{wish}"], float))
        - np.log(np.asarray(played[0][f"{what}_{wish}"], float))
        for what in ("liked", "done")
    )
    known = np.isfinite(done)
    weight = np.where(known, liked**2, 0.0).sum(axis=(1, 2))
    moved = np.where(known, liked * np.nan_to_num(done), 0.0).sum(axis=(1, 2))
    return (moved / np.maximum(weight, 1e-9)).tolist()
