"""Kinds of robots that train with persons, for the gates of persons."""

import dataclasses
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, make
from assistax_envs.persons import PersonPlayer
from assistax_envs.persons.rows import FAMILIES as ALL
from assistax_envs.persons.rows import INNER, ROWS, UNSEEN
from assistax_workshop.gates.persons.play import (
    FAMILIES,
    SINGLE,
    SINGLE_EPISODES,
    Plan,
    about,
    play_persons,
    play_strangers,
    rollout_with_persons,
    rows_of,
    training_persons,
)
from assistax_workshop.gates.training import CHANGES
from assistax_zoo.shell.console import TrainingLine
from population.config import MIXED, Member, make_run
from population.hyperparameters import robot_preset
from population.networks.stack import PolicyStack
from population.networks.tensors import flatten, row_sha256
from population.partners.drawn_persons import DrawnPersons, IdlePersons, OnePersonEach
from population.runs.train import train
from population.runs.trained import read_trained_run


def _training_side(plan: Plan) -> np.ndarray:
    """Return the persons that robots train with: inner rows of the training families."""
    return training_persons(len(FAMILIES) * INNER)


def _test_side(plan: Plan) -> np.ndarray:
    """Return the corners of the training families, and inner persons of the unseen one."""
    corners = np.arange(INNER, ROWS)
    known = [ALL.index(family) * ROWS + corners for family in FAMILIES]
    return np.concatenate([*known, ALL.index(UNSEEN) * ROWS + np.arange(INNER)])


def _sample(plan: Plan) -> np.ndarray:
    """Return the persons who have a robot each."""
    return np.array(plan.sample)


@dataclasses.dataclass(frozen=True)
class Robots:
    """Kind of robot: its method, its partners and its observations.

    Attributes:
        method: Of `population.hyperparameters`: "ppo", or one of its `METHODS`.
        told: Roles that observe the person's preference.
        masked: Whether its persons neither speak nor lean for what they like.
        changes: Changes of the task's hyperparameters.
        partners: A person for each episode; the same but idle; or one for each robot.
        met: Function of the plan that returns the numbers of the persons.
        teacher: Kind of the robots that it imitates, which the folder must hold.
        steps: Environment steps of each robot, unless the plan has others.
    """

    method: str = "asymmetric_gru"
    told: tuple[str, ...] = ("human",)
    masked: bool = False
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    partners: type[DrawnPersons] = DrawnPersons
    met: Callable[[Plan], np.ndarray] = _training_side
    teacher: str = ""
    steps: int = 50_000_000


BOTH = ("human", "robot")
# A critic without a memory does not see whether its person still wants to go on. With a lambda
# below .99 that error likely gets into the advantages: PPO unlearns feeding
# (docs/log/ppo_with_persons.md).
WITH_PERSONS = {
    "num_envs": 512,
    "rollout_steps": 128,
    "minibatches": 8,
    "gae_lambda": 0.99,
}
# Few simulations learn more from the same number of steps, but less gently.
FEW = {"num_envs": 256, "rollout_steps": 64, "learning_rate": 1e-3}
# Robots with a memory learn with a critic that sees the wishes: without it two of four told robots
# of gentle bath learned nothing (docs/log/care.md).
ROBOTS: Mapping[str, Robots] = {
    "ppo": Robots("ppo"),
    "gru": Robots(),
    "told-gru": Robots(told=BOTH),
    "masked": Robots(masked=True),
    "rma": Robots("rma"),
    "osi": Robots("osi"),
    "dagger": Robots("dagger", teacher="told-gru", steps=20_000_000),
    "learned": Robots("dagger", teacher="told-gru", steps=20_000_000, met=_test_side),
    "idle": Robots("gru", partners=IdlePersons),
    "best": Robots(
        "gru", told=BOTH, changes=FEW, partners=OnePersonEach, met=_sample, steps=20_000_000
    ),
}


def recipe_with_persons(task: str) -> dict[str, Any]:
    """Return the changes of PPO's preset for robots of a gentle task that train with persons."""
    return {**CHANGES[task], "learning_rate": 5e-4, **WITH_PERSONS}


def play_robots(plan: Plan, name: str) -> dict[str, Any]:
    """Train the robots of a kind; return their results with persons, by side."""
    kind = ROBOTS[name]
    env = make(plan.task, plan.backend, told=kind.told)
    run = read_trained_run(_train(plan, name, kind, env))
    robots, paired = run.policies["robot"], kind.partners is OnePersonEach
    policy, params = robots.spec.player(), jax.tree.map(jnp.asarray, robots.params)
    rollout = rollout_with_persons(plan, env, policy, paired=paired)
    single = play_persons(
        rollout, plan.task, params, _sample(plan), SINGLE_EPISODES, masked=kind.masked
    )
    sides = {SINGLE: single}
    if not paired:
        sides |= play_strangers(rollout, plan, params, kind.masked)
    return {"about": about(plan, env, run.config.steps, run.config.trainer), "sides": sides}


def _train(plan: Plan, name: str, kind: Robots, env: Env) -> Path:
    """Train the robots of a kind; return the folder of the run."""
    met = kind.met(plan)
    rows = jnp.asarray(rows_of(plan.task, met, kind.masked))
    seeds = plan.sample if kind.partners is OnePersonEach else plan.seeds
    partners = kind.partners(PersonPlayer(plan.task), rows, f"persons-{name}")
    recipe = {} if kind.teacher else recipe_with_persons(plan.task)
    changes = {**recipe, **kind.changes, **plan.changes}
    teacher = _teacher(plan, kind.teacher, len(seeds)) if kind.teacher else None
    config = make_run(
        plan.task,
        kind.method,
        [Member(seed, MIXED) for seed in seeds],
        plan.steps or kind.steps,
        robot_preset(kind.method, **changes),
        self_play_episodes=0,
        precision="float16",  # in which the care track's robots are published
        partners=partners.ids,
    )
    key = {"partners": row_sha256({"rows": np.asarray(partners.rows)})}
    if teacher:
        key["teacher"] = row_sha256(flatten(teacher.params))
    config, folder = dataclasses.replace(config, key=key), plan.folder / name
    with TrainingLine(str(folder)) as line:
        return train(config, env, folder, partners=partners, teacher=teacher, progress=line)


def _teacher(plan: Plan, kind: str, count: int) -> PolicyStack:
    """Return a teacher for each of so many robots: the best quarter of a kind's, in turns.

    Best is the return with persons of the validation side. The robots of a teacher that has not
    learned the task cannot learn it either, and half of a kind may not have learned it.

    Raises:
        ValueError: The folder has no such robots yet.
    """
    results = plan.folder / f"{kind}.json"
    if not results.exists():
        raise ValueError(f"{plan.folder} has no {kind} to imitate; train that kind first")
    found = json.loads(results.read_text())
    means = np.mean(found["sides"]["validation"]["return"], axis=(1, 2))
    best = np.argsort(-means, kind="stable")[: -(-len(means) // 4)]
    robots = read_trained_run(plan.folder / kind).policies["robot"]
    return robots.take([int(best[place % len(best)]) for place in range(count)])
