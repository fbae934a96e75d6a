"""Reading of preferences from a robot's observations, by scripts and by trained robots.

A robot's behaviour limits what it can read: see `assistax_envs.persons.measure`.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.persons import measure, numbers, persons
from assistax_envs.persons.parameters import index
from assistax_envs.tasks.chain import SCRIPTS
from assistax_workshop.gates.persons_play import Plan
from population.networks.policy import Policy
from population.runs.trained import read_trained_run

READERS = 900  # persons; the preferences of a third are predicted from the others
STEPS = 600  # of each episode
TRAINED = ("gru", "ppo")  # kinds whose first robot reads too, if it was trained in this folder


def read_preferences(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return the share of persons whose preference is read, by robot, quantity and seconds."""
    task, found = plan.task, {}
    rows = persons(task)[numbers("training")][:READERS]
    robots: dict[str, Any] = {kind: _trained(plan, kind) for kind in TRAINED}
    robots |= {"probe": "probe"} if SCRIPTS[task].force is not None else {}
    robots["script"] = "script"
    columns = {quantity: index(task)[quantity] for quantity in measure.preference_parameters(task)}
    for name, robot in robots.items():
        if robot is not None:
            seen = measure.episodes(task, rows, robot, steps=plan.horizon or STEPS)
            found[name] = {key: _read(seen, rows[:, column]) for key, column in columns.items()}
            progress(f"preferences read by {name}: {found[name]}")
    return {"about": {"task": task, "persons": len(rows)}, "read": found}


def _read(seen: dict[str, np.ndarray], values: np.ndarray) -> dict[str, dict[str, float]]:
    """Return by seconds the share of persons read, their number, and the share by chance."""
    mixed, shares = np.random.default_rng(0).permutation(values), {}
    for window in measure.WINDOWS:
        (share, count), (chance, _) = (measure.read(seen, of, window) for of in (values, mixed))
        shares[f"{window:g}"] = {"share": share, "of": count, "shuffled": chance}
    return shares


def _trained(plan: Plan, kind: str) -> measure.Robot | None:
    """Return the first robot of a kind that this folder has trained; None if there is none."""
    folder = plan.folder / kind
    if not (folder / "teams.json").exists():
        return None
    stack = read_trained_run(folder).policies["robot"]
    policy, params = (
        Policy(stack.spec),
        jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), stack.params),
    )

    def act(memory: Any, obs: jax.Array, time: jax.Array) -> tuple[Any, jax.Array]:
        return policy.act(params, memory, obs, jnp.broadcast_to(time == 0, obs.shape[:1]))

    return (lambda n: policy.initial_carry((n,))), act
