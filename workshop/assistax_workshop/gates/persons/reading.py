"""Reading of wishes from a robot's observations, by scripts and by trained robots.

A robot's behaviour limits what it can read. `reader` has the networks that read.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.persons import measure, persons
from assistax_envs.persons.rows import INNER, index
from assistax_envs.preferences import PREFERRED
from assistax_workshop.gates.persons.play import FAMILIES, Plan
from assistax_workshop.gates.persons.reader import SEEN, Windows, moments, read_thirds, share_found
from population.runs.trained import read_trained_run

LEARNED, TESTED = 2_000, 200  # persons of each family
STEPS = 600  # of each episode
WINDOW = 5.0  # s from the first step in which a wish is judged: before it there is nothing to read
LEAST = 9  # persons of each use with so long a window
TRAINED = ("gru", "ppo")  # kinds whose first robot reads too, if it was trained in this folder
# Groups of persons by how often they speak: those who never do show little, too.
TALKING = {"never": (-1.0, 0.0), "at times": (0.0, 0.75), "often": (0.75, 1.0)}


def read_wishes(plan: Plan, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Return the shares of corners' wishes whose third is found, by robot.

    Readers learn with persons of the training families and are tested with their corners.
    """
    task, found = plan.task, {}
    robots: dict[str, Any] = {kind: _trained(plan, kind) for kind in TRAINED}
    robots |= {"probe": "probe", "script": "script"}
    for name, robot in robots.items():
        if robot is not None:
            found[name] = _read(plan, robot)
            for line in lines(found[name]):
                progress(f"read by {name}: {line}")
    return {"about": {"task": task, "learned": LEARNED, "seconds": WINDOW}, "read": found}


def lines(found: dict[str, Any]) -> list[str]:
    """Return a line of text for each wish."""
    return [
        f"{wish} of {shares['of']} who show or speak: "
        + ", ".join(f"{seen} {shares[seen]:.0%}" for seen in SEEN)
        + "; by speaking: "
        + ", ".join(f"{group} {share:.0%}" for group, share in shares["talking"].items())
        for wish, shares in found.items()
    ]


def _read(plan: Plan, robot: Any) -> dict[str, dict[str, Any]]:
    """Return the shares by wish; see `lines`. Without enough touched persons there are none."""
    task, place = plan.task, index(plan.task)
    inner = np.arange(INNER)
    inner = inner[inner % 10 != 9]
    learned, tested = inner[:: max(len(inner) // LEARNED, 1)][:LEARNED], INNER + np.arange(TESTED)
    wishes = [place[f"liked_{name}"] for name in PREFERRED[task]]
    bounds = np.quantile(persons(task)[learned][:, wishes], [1 / 3, 2 / 3], axis=0)
    (learn, _), (test, rows) = (
        _windows(plan, robot, numbers, wishes, bounds) for numbers in (learned, tested)
    )
    if min(len(learn.thirds), len(test.thirds)) < LEAST:
        return {}
    found, talks = read_thirds(learn, test), rows[:, place["talkative"]]
    shares = {}
    for at, wish in enumerate(PREFERRED[task]):

        def share(seen: str, who: np.ndarray, at: int = at) -> float:
            return share_found(found[seen][who, at], test.thirds[who, at])

        groups = {n: (talks > low) & (talks <= high) for n, (low, high) in TALKING.items()}
        shares[wish] = {seen: share(seen, talks > 0.0) for seen in SEEN} | {
            "of": int((talks > 0.0).sum()),
            "talking": {name: share("both", who) for name, who in groups.items()},
        }
    return shares


def _windows(
    plan: Plan, robot: Any, numbers: np.ndarray, wishes: list[int], bounds: np.ndarray
) -> tuple[Windows, np.ndarray]:
    """Return the windows of persons of the training families, and the persons' rows [P, 30]."""
    rows, length = persons(plan.task)[numbers], round(WINDOW * measure.STEPS_A_SECOND)
    features, touched = [], []
    for family in FAMILIES:
        steps = plan.horizon or STEPS
        seen = measure.episodes(plan.task, rows, robot, family=family, steps=steps)
        judged = seen["judged"].any(axis=-1)
        begin, length = judged.argmax(axis=0), min(length, steps)
        enough = judged.any(axis=0) & (begin + length <= steps)
        at = begin[None, enough] + np.arange(length)[:, None]
        features.append(moments(seen["obs"][at, np.flatnonzero(enough)[None]]))
        touched.append(rows[enough])
    known = np.concatenate(touched)
    thirds = (known[:, wishes] > bounds[:, None]).sum(axis=0)
    return Windows(np.concatenate(features), thirds), known


def _trained(plan: Plan, kind: str) -> measure.Robot | None:
    """Return the first robot of a kind that this folder has trained; None if there is none."""
    folder = plan.folder / kind
    if not (folder / "teams.json").exists():
        return None
    stack = read_trained_run(folder).policies["robot"]
    policy = stack.spec.player()
    params = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), stack.params)

    def act(memory: Any, obs: jax.Array, time: jax.Array) -> tuple[Any, jax.Array]:
        return policy.act(params, memory, obs, jnp.broadcast_to(time == 0, obs.shape[:1]))

    return (lambda n: policy.initial_carry((n,))), act
