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
from population.play.rollout import Rollout

# Sides of persons that no robot met, by name: the first number, the step, and the family.
STRANGERS = {
    "validation": (9, 10, "spring"),
    "corners": (8000, 1, "spring"),
    "muscle": (9000, 1, "muscle"),
}
FAMILIES = ("spring", "muscle")  # that robots train with
SIDE = 200  # persons of each
EPISODES = 2  # with each of them
SPRINGS = 9_000  # persons of the family `spring`, for which best responses are trained
SINGLE = "single"  # name of a sample of them, which plays more episodes
SINGLE_EPISODES = 20


@dataclasses.dataclass(frozen=True)
class Plan:
    """Settings of the stages of a task.

    Attributes:
        task: Gentle task.
        folder: Folder of all stages.
        seeds: Seeds of the robots; a best response has its person's number.
        steps: Environment steps of each robot; the kind's own if not given.
        single: Number of persons with a best response.
        tries: Tries of the search over the script's numbers.
        models: Persons of each try.
        changes: Changes of hyperparameters, for all kinds.
        backend: Physics.
        horizon: Steps of an evaluated episode; the environment's if not given.
    """

    task: str
    folder: Path
    seeds: Sequence[int] = range(16)
    steps: int | None = None
    single: int = 50
    tries: int = 200
    models: int = 64
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    backend: str = "auto"
    horizon: int | None = None

    @property
    def sample(self) -> range:
        """Numbers of the persons with a best response, spread evenly over the first family."""
        return range(0, SPRINGS, SPRINGS // self.single)[: self.single]


def play_strangers(plan: Plan, env: Env, policy: Any, params: Any, side: str) -> dict[str, Any]:
    """Return the results of robots with strangers of a side; see `play_persons`."""
    first, apart, family = STRANGERS[side]
    met = np.arange(first, len(persons(plan.task)), apart)[:SIDE]
    rollout = rollout_with_persons(plan, env, policy, family)
    return play_persons(rollout, plan.task, params, met, EPISODES)


def play_single(
    plan: Plan, env: Env, policy: Any, params: Any, alone: bool = False
) -> dict[str, Any]:
    """Return the results of robot i with person i of the sample, or of one robot with them all."""
    rollout = rollout_with_persons(plan, env, policy, paired=not alone)
    return play_persons(rollout, plan.task, params, np.array(plan.sample), SINGLE_EPISODES)


def rollout_with_persons(
    plan: Plan, env: Env, policy: Any, family: str = "spring", paired: bool = False
) -> Rollout:
    """Return the rollout of robots of one form with persons of a family."""
    human = PersonPlayer(plan.task, family)
    return Rollout(env, [policy], [human], paired=paired, length=plan.horizon)


@own_settings()
def play_persons(
    rollout: Rollout, task: str, params: Any, met: np.ndarray, episodes: int
) -> dict[str, Any]:
    """Return the results of robots [M] in each episode with the persons [P] numbered `met`.

    "return" and "safe_success" are [M, P, K]; M is 1 if robot i is paired with person i.
    """
    keys = jax.random.split(key_of(99), (len(met), episodes))
    rows = persons(task)[met]
    body, stack = person_params(task, rows), {"row": jnp.asarray(rows)}
    tally = rollout.run([params], [stack], body, keys)
    safe = tally.success & ~tally.violated
    return {
        "persons": met.tolist(),
        "return": np.round(np.asarray(tally.returns, np.float64), 3).tolist(),
        "safe_success": np.asarray(safe, int).tolist(),
    }


def about(plan: Plan, env: Env, steps: int = 0, trainer: Any = None) -> dict[str, Any]:
    """Return the task, version, backend, steps and hyperparameters of a stage."""
    return {
        "task": plan.task,
        "env_version": env.version,
        "backend": env.backend,
        "steps": steps,
        "trainer": trainer and {**dataclasses.asdict(trainer), "hidden": list(trainer.hidden)},
    }
