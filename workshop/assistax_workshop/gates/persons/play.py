"""Play of robots with persons, for the gates of persons."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env
from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.persons import PersonPlayer, person_params, persons
from assistax_envs.persons.rows import FAMILIES as ALL
from assistax_envs.persons.rows import INNER, ROWS, UNSEEN, index, marked
from assistax_envs.persons.senses import SEAT_SIZES
from assistax_envs.preferences import PREFERRED
from population.play.caring import caring_columns
from population.play.rollout import Rollout

FAMILIES = tuple(family for family in ALL if family != UNSEEN)  # that robots train with
# Sides of persons that no robot met, by name: families, and the rows that persons are taken from.
STRANGERS: Mapping[str, tuple[Sequence[str], range]] = {
    "validation": (FAMILIES, range(9, INNER, 10)),
    "corners": (FAMILIES, range(INNER, ROWS)),
    "unseen": ((UNSEEN,), range(INNER)),
}
SIDE = 200  # persons of each
EPISODES = 2  # with each of them
SINGLE = "single"  # name of a sample of the first family, which plays more episodes
SINGLE_EPISODES = 20
SIGNS = ("expressive", "talkative")  # numbers that masked persons have not


@dataclasses.dataclass(frozen=True)
class Plan:
    """Settings of the stages of a task.

    Attributes:
        task: Gentle task.
        folder: Folder of all stages.
        seeds: Seeds of the robots; a best response has its person's number.
        steps: Environment steps of each robot; the kind's own if not given.
        single: Number of persons with a best response.
        tries: Tries of a search over the script's numbers.
        models: Persons of each try.
        programs: Open-loop programs that are tried.
        changes: Changes of hyperparameters, for all kinds.
        backend: Physics.
        horizon: Steps of an evaluated episode; the environment's if not given.
    """

    task: str
    folder: Path
    seeds: Sequence[int] = range(8)
    steps: int | None = None
    single: int = 50
    tries: int = 400
    models: int = 32
    programs: int = 256
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    backend: str = "auto"
    horizon: int | None = None

    @property
    def sample(self) -> range:
        """Numbers of the persons with a best response, spread evenly over the first family."""
        return range(0, ROWS, ROWS // self.single)[: self.single]


class AnyPerson(PersonPlayer):
    """Persons, stacked; if `idle`, they do and say nothing."""

    def __init__(self, task: str, idle: bool = False) -> None:
        super().__init__(task)
        self._torques = SEAT_SIZES[task][1] if idle else 0

    def act_stack(
        self, params: Any, carry: Any, obs: jax.Array, first: jax.Array
    ) -> tuple[Any, jax.Array]:
        """See `PersonPlayer.act_stack`."""
        if self._torques:
            return carry, jnp.zeros((*obs.shape[:-1], self._torques), obs.dtype)
        return super().act_stack(params, carry, obs, first)


def rows_of(task: str, met: np.ndarray, masked: bool = False) -> np.ndarray:
    """Return the rows [P, 31] of persons by number, as `rows.marked` has them.

    `masked` persons neither speak nor lean for what they like.
    """
    rows = np.array(persons(task)[met % ROWS])
    if masked:
        rows[:, [index(task)[name] for name in SIGNS]] = 0.0
    return marked(rows, met // ROWS)


def strangers(side: str) -> np.ndarray:
    """Return the numbers of the persons of a side, or of any of `STRANGERS`' families."""
    families, rows = STRANGERS[side]
    share = SIDE // len(families)
    chosen = np.array(rows)[:: max(len(rows) // share, 1)][:share]
    return np.concatenate([ALL.index(family) * ROWS + chosen for family in families])


def training_persons(count: int, rows: range = range(INNER)) -> np.ndarray:
    """Return about `count` numbers of the training side, spread over both families."""
    inner = np.array([row for row in rows if row % 10 != 9])
    chosen = inner[:: max(len(inner) * len(FAMILIES) // count, 1)][: -(-count // len(FAMILIES))]
    return np.concatenate([ALL.index(family) * ROWS + chosen for family in FAMILIES])[:count]


def play_strangers(rollout: Rollout, plan: Plan, params: Any, masked: bool = False) -> Any:
    """Return the results of robots with strangers, by side; see `play_persons`."""
    return {
        side: play_persons(rollout, plan.task, params, strangers(side), EPISODES, masked)
        for side in STRANGERS
    }


def rollout_with_persons(
    plan: Plan, env: Env, policy: Any, idle: bool = False, paired: bool = False
) -> Rollout:
    """Return the rollout of robots of one form with persons of all families."""
    human = AnyPerson(plan.task, idle)
    return Rollout(env, [policy], [human], paired=paired, length=plan.horizon)


def play_persons(
    rollout: Rollout,
    task: str,
    params: Any,
    met: np.ndarray,
    episodes: int,
    masked: bool = False,
) -> dict[str, Any]:
    """Return the results of robots [M] in each episode with the persons [P] numbered `met`.

    "return", "success" (caring success), "discomfort_share", "violation", and for each wish
    "liked_", "done_" and "within_" are [M, P, K]; M is 1 if robot i is paired with person i. What
    was never done is None.
    """
    played = play_rows(rollout, task, params, rows_of(task, met, masked), episodes)
    return {"persons": met.tolist()} | {name: _listed(values) for name, values in played.items()}


@own_settings()
def play_rows(
    rollout: Rollout, task: str, params: Any, rows: np.ndarray, episodes: int
) -> dict[str, np.ndarray]:
    """Return the results [M, P, K] by name of robots with persons of rows [P, 31]."""
    keys = jax.random.split(key_of(99), (len(rows), episodes))
    body, stack = person_params(task, rows), {"row": jnp.asarray(rows)}
    tally = rollout.run([params], [stack], body, keys)
    with np.errstate(invalid="ignore"):
        cared = caring_columns(tally.caring, PREFERRED[task])
    played = {"return": tally.returns, "success": tally.success} | cared
    return {name: np.asarray(values) for name, values in played.items()}


def about(plan: Plan, env: Env, steps: int = 0, trainer: Any = None) -> dict[str, Any]:
    """Return the task, version, backend, steps and hyperparameters of a stage."""
    return {
        "task": plan.task,
        "env_version": env.version,
        "backend": env.backend,
        "steps": steps,
        "trainer": trainer and {**dataclasses.asdict(trainer), "hidden": list(trainer.hidden)},
    }


def _listed(values: np.ndarray) -> list[Any]:
    """Return values as lists, rounded; those that are not finite are None."""
    rounded = np.round(np.asarray(values, np.float64), 4)
    listed = rounded.astype(object)
    listed[~np.isfinite(rounded)] = None
    return listed.tolist()
