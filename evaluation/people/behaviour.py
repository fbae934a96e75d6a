"""How people and persons behave in an episode: pace, delay, force and words, measured alike.

The same few numbers are computed from the steps of an episode, whoever is in the human's seat:

- pace, rad/s: 90th percentile of the speed at which all joints of the human move together;
- delay, s: from the moment a wish is a quarter off until the human first says a word that asks for
  less, or more, of it; median over these moments. None if no such word was said;
- force, N: median over the steps in which the human is touched. None without a touch;
- words, 1/min: words said.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from assistax_envs.persons.measure import episodes
from assistax_envs.persons.rows import FAMILIES, INNER, persons
from assistax_envs.persons.signs import ANNOYS, LINGERS
from assistax_envs.preferences import ASKS, PREFERRED, code
from assistax_envs.tasks.gentle_base import FELT, STEP
from evaluation.people.robots import SeatRobot

NAMES = {"pace": "rad/s", "delay": "s", "force": "N", "words": "1/min"}
QUARTILES = (0.25, 0.5, 0.75)
MOST_PERSONS = 200  # of each family


@dataclasses.dataclass(frozen=True)
class Distribution:
    """Distribution of a number over episodes."""

    episodes: int  # that have it
    quartiles: tuple[float, ...] | None  # None if no episode has it


def behaviour(
    task: str, steps: Mapping[str, np.ndarray], words: Int[np.ndarray, " T"]
) -> dict[str, float | None]:
    """Return the numbers of an episode, by the names of `NAMES`.

    Args:
        task: The task.
        steps: What each of T steps gave: "moved" (rad), "force" (N), and "done", "judged", "liked"
            of the wishes [T, W].
        words: Codes of the words said with the actions of each step; 0 for silence.
    """
    touched = steps["force"][steps["force"] > FELT]
    off = np.log(np.maximum(steps["done"], 1e-3) / steps["liked"])
    delays = [
        delay
        for place, wish in enumerate(PREFERRED[task])
        if wish in ASKS
        for sign, word in zip((1.0, -1.0), ASKS[wish], strict=True)
        for delay in _delays(
            steps["judged"][:, place], sign * off[:, place] > ANNOYS, words == code(word)
        )
    ]
    return {
        "pace": float(np.quantile(steps["moved"], 0.9) / STEP),
        "delay": float(np.median(delays)) if delays else None,
        "force": float(np.median(touched)) if touched.size else None,
        "words": float((words > 0).sum() / (len(words) * STEP / 60.0)),
    }


def _delays(
    judged: Bool[np.ndarray, " T"], off: Bool[np.ndarray, " T"], said: Bool[np.ndarray, " T"]
) -> list[float]:
    """Return the times, s, from the beginnings of being off to the first word about it.

    Being off goes on through gaps in which the wish is not judged, up to `LINGERS`.
    """
    found, began, gap = [], None, 0.0
    for step in range(len(judged)):
        # A word goes with an action: what it answers was felt before this step.
        if said[step] and began is not None and began >= 0:
            found.append((step - began) * STEP)
            began = -1  # answered, until it is no longer off
        gap = 0.0 if judged[step] else gap + STEP
        if judged[step] and not off[step]:
            began = None
        elif judged[step] and began is None:
            began = step
        elif gap > LINGERS:
            began = None
    return found


def distributions(
    rows: Sequence[Mapping[str, float | None]],
) -> dict[str, Distribution]:
    """Return the distribution of each number over episodes."""
    found = {}
    for name in NAMES:
        values = [value for row in rows if (value := row[name]) is not None]
        ends = tuple(map(float, np.quantile(values, QUARTILES))) if values else None
        found[name] = Distribution(len(values), ends)
    return found


def persons_behaviour(
    task: str, robot: SeatRobot, count: int, seed: int = 0
) -> list[dict[str, float | None]]:
    """Return the numbers of an episode of each of some persons with a robot.

    Args:
        task: The task.
        robot: The robot.
        count: Persons of each family, evenly from those that are no corners.
        seed: Seed of the starts.

    Raises:
        ValueError: The count is not allowed.
    """
    if not 1 <= count <= MOST_PERSONS:
        raise ValueError(f"persons is {count}; allowed are 1 to {MOST_PERSONS} of each family")
    rows = persons(task)[np.linspace(0, INNER - 1, count).astype(int)]
    return [
        _numbers_of(task, seen, place)
        for family in FAMILIES
        for seen in [episodes(task, rows, _stepwise(task, robot, rows), family=family, seed=seed)]
        for place in range(count)
    ]


def _numbers_of(task: str, seen: Mapping[str, np.ndarray], place: int) -> dict[str, float | None]:
    """Return the numbers of the episode of one person, up to its end."""
    count = int((~seen["terminated"][:, place]).sum())
    steps = {name: seen[name][:count, place] for name in ("moved", "force", "done", "judged")}
    steps["liked"] = seen["liked"][:count, place]
    return behaviour(task, steps, seen["word"][:count, place])


def _stepwise(task: str, robot: SeatRobot, rows: Float[np.ndarray, "N 30"]) -> Any:
    """Return a robot as `episodes` takes it: its memory at the start, and its step."""
    from assistax_envs.persons.player import person_params

    wishes = person_params(task, rows).preference.of(task)
    params = robot.params_for(wishes)

    def act(memory: Any, obs: jax.Array, time: jax.Array) -> tuple[Any, jax.Array]:
        first = jnp.broadcast_to(time == 0, (obs.shape[0],))
        return robot.player.act(params, memory, obs, first)

    return (lambda count: robot.player.initial_carry((count,))), act
