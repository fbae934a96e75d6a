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

# Sides of persons that no robot met, by name: the first number, how far apart, and the family.
STRANGERS = {
    "validation": (9, 10, "spring"),
    "corners": (8000, 1, "spring"),
    "muscle": (9000, 1, "muscle"),
}
SIDE = 200  # persons of each
EPISODES = 2  # with each of them
SPRINGS = 9_000  # persons of the family `spring`, of whom best responses are learned
SINGLE = "single"  # what a sample of them is called, each of whom plays more episodes
SINGLE_EPISODES = 20


@dataclasses.dataclass(frozen=True)
class Plan:
    """How the stages of a task are trained and played.

    Attributes:
        task: Gentle task.
        folder: Of all stages.
        seeds: Of the robots; those of single persons have a person's number.
        steps: Environment steps of each robot; the kind's own if not given.
        single: How many persons have a best response.
        tries: Of the search over the script's numbers.
        models: Persons whom each try plays with.
        changes: Of hyperparameters, for all kinds.
        backend: Physics.
        horizon: Steps of an episode that is played; the environment's if not given.
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
        """Return the numbers of the persons with a best response, all over the first family."""
        return range(0, SPRINGS, SPRINGS // self.single)[: self.single]


def play_strangers(plan: Plan, env: Env, policy: Any, params: Any, side: str) -> dict[str, Any]:
    """Play robots with persons of a side that none of them met; see `play_persons`."""
    first, apart, family = STRANGERS[side]
    met = np.arange(first, len(persons(plan.task)), apart)[:SIDE]
    rollout = rollout_with_persons(plan, env, policy, family)
    return play_persons(rollout, plan.task, params, met, EPISODES)


def play_single(
    plan: Plan, env: Env, policy: Any, params: Any, alone: bool = False
) -> dict[str, Any]:
    """Play robot i with person i of the sample, or one robot with all of them."""
    rollout = rollout_with_persons(plan, env, policy, paired=not alone)
    return play_persons(rollout, plan.task, params, np.array(plan.sample), SINGLE_EPISODES)


def rollout_with_persons(
    plan: Plan, env: Env, policy: Any, family: str = "spring", paired: bool = False
) -> Rollout:
    """Return what plays robots of one form with persons of a family."""
    human = PersonPlayer(plan.task, family)
    return Rollout(env, [policy], [human], paired=paired, length=plan.horizon)


@own_settings()
def play_persons(
    rollout: Rollout, task: str, params: Any, met: np.ndarray, episodes: int
) -> dict[str, Any]:
    """Return what robots [M] earn in each episode with persons [P] of these numbers.

    "return" and "safe_success" are [M, P, K]; M is 1 where robot i is paired with person i.
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
    """Return what the figures of a stage are of."""
    return {
        "task": plan.task,
        "env_version": env.version,
        "backend": env.backend,
        "steps": steps,
        "trainer": trainer and {**dataclasses.asdict(trainer), "hidden": list(trainer.hidden)},
    }
