"""Stages of the gates of persons: robots that train with persons, and their returns with them.

Each kind of robot is a stage: a run in FOLDER/NAME, which can be resumed, and FOLDER/NAME.json with
the results of its robots with persons. `persons_table` reads these files, so that stages may run on
several machines.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.files import write_json
from assistax_envs import Env, make
from assistax_envs.persons import PersonPlayer, numbers, persons
from assistax_workshop.gates.persons_play import (
    SINGLE,
    STRANGERS,
    Plan,
    about,
    play_single,
    play_strangers,
)
from assistax_workshop.gates.persons_reading import read_wishes
from assistax_workshop.gates.script_search import search_script
from assistax_workshop.gates.training import CHANGES, KNOWING
from assistax_zoo.shell.console import TrainingLine
from evaluation.play.baselines import script_roster
from population.config import MIXED, Member, make_run
from population.hyperparameters import preset
from population.networks.policy import Policy
from population.networks.stack import PolicyStack
from population.networks.tensors import row_sha256
from population.runs.train import train
from population.runs.trained import read_trained_run
from population.trainers.drawn_persons import DrawnPersons, IdlePersons, OnePersonEach


@dataclasses.dataclass(frozen=True)
class Robots:
    """Kind of robot: its partners, its observations and its hyperparameters.

    Attributes:
        told: Roles that observe the person's preference.
        changes: Changes of the task's hyperparameters.
        partners: The training side's persons, a new one each episode; the same but idle; or one
            person of a sample for each robot.
        steps: Environment steps of each robot, unless the plan has others.
    """

    told: tuple[str, ...] = ("human",)
    changes: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    partners: type[DrawnPersons] = DrawnPersons
    steps: int = 50_000_000


BOTH, MEMORY = ("human", "robot"), {"torso": "gru"}
# A critic without a memory does not see whether its person still wants to go on. With a lambda
# below .99, or short rollouts, that error likely gets into the advantages: PPO unlearns feeding
# (docs/log/ppo_with_persons.md).
WITH_PERSONS = {"num_envs": 512, "rollout_steps": 256, "gae_lambda": 0.99}
# Few simulations learn more from the same number of steps, but less gently. Best responses have
# 10 M steps, and the rollouts with which they were measured.
FEW = {"num_envs": 256, "rollout_steps": 64, "gae_lambda": 0.95, "learning_rate": 1e-3}
ROBOTS: Mapping[str, Robots] = {
    "ppo": Robots(),
    KNOWING: Robots(told=BOTH),
    "gru": Robots(changes=MEMORY),
    "told-gru": Robots(told=BOTH, changes=MEMORY),
    "idle": Robots(partners=IdlePersons),
    "best": Robots(changes=FEW, partners=OnePersonEach, steps=10_000_000),
}
SCRIPT, SEARCH, READ = "script", "search", "read"
STAGES = (*ROBOTS, SCRIPT, SEARCH, READ)


def recipe_with_persons(task: str) -> dict[str, Any]:
    """Return the changes of PPO's preset for robots of a gentle task that train with persons."""
    return {**CHANGES[task], "learning_rate": 5e-4, **WITH_PERSONS}


def run_stages(
    plan: Plan, stages: Sequence[str] = STAGES, progress: Callable[[str], None] = print
) -> None:
    """Train and play stages; results that the folder holds are not made again.

    Raises:
        ValueError: There is no such stage.
    """
    if unknown := [name for name in stages if name not in STAGES]:
        raise ValueError(f"stage is {unknown[0]!r}; allowed are {', '.join(STAGES)}")
    plan.folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(stages, 1):
        progress(f"stage {number} of {len(stages)}, {name}")
        earned = _stage(plan, name, progress)
        write_json(plan.folder / f"{name}.json", earned)
        for side, figures in earned.get("sides", {}).items():
            mean, safe = (np.mean(figures[what]) for what in ("return", "safe_success"))
            progress(f"{name} with {side}: return {mean:.1f}, safe success {safe:.0%}")


def _stage(plan: Plan, name: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Return the results of one stage."""
    if name == SCRIPT:
        return play_script(plan)
    if name == SEARCH:
        return search_script(plan, progress)
    if name == READ:
        return read_wishes(plan, progress)
    return play_robots(plan, name)


def play_robots(plan: Plan, name: str) -> dict[str, Any]:
    """Train the robots of a kind; return their returns and safe successes with persons, by side."""
    kind = ROBOTS[name]
    env = make(plan.task, plan.backend, told=kind.told)
    run = read_trained_run(_train(plan, name, kind, env))
    robots, sides = run.policies["robot"], {}
    policy, params = Policy(robots.spec), jax.tree.map(jnp.asarray, robots.params)
    if kind.partners is OnePersonEach:
        sides[SINGLE] = play_single(plan, env, policy, params)
    else:
        for side in STRANGERS:
            sides[side] = play_strangers(plan, env, policy, params, side)
    return {"about": about(plan, env, run.config.steps, run.config.trainer), "sides": sides}


def play_script(plan: Plan) -> dict[str, Any]:
    """Return the script's results with strangers, and with the persons of best responses."""
    env = make(plan.task, plan.backend)
    sizes = env.observation_size["robot"], env.action_size["robot"]
    [stack] = script_roster(plan.task, *sizes).stacks
    assert isinstance(stack, PolicyStack)
    policy, params = stack.spec.player(), jax.tree.map(jnp.asarray, stack.params)
    sides = {SINGLE: play_single(plan, env, policy, params, alone=True)}
    for side in STRANGERS:
        sides[side] = play_strangers(plan, env, policy, params, side)
    return {"about": about(plan, env), "sides": sides}


def _train(plan: Plan, name: str, kind: Robots, env: Env) -> Path:
    """Train the robots of a kind; return the folder of the run."""
    rows, seeds = persons(plan.task), plan.seeds
    met = rows[numbers("training")]
    if kind.partners is OnePersonEach:
        met, seeds = rows[list(plan.sample)], plan.sample
    partners = kind.partners(PersonPlayer(plan.task), jnp.asarray(met), f"persons-{name}")
    config = make_run(
        plan.task,
        "ippo",
        [Member(seed, MIXED) for seed in seeds],
        plan.steps or kind.steps,
        preset("ippo", **{**recipe_with_persons(plan.task), **kind.changes, **plan.changes}),
        self_play_episodes=0,
        partners=partners.ids,
    )
    key = {"partners": row_sha256({"rows": np.asarray(partners.rows)})}
    config, folder = dataclasses.replace(config, key=key), plan.folder / name
    with contextlib.closing(TrainingLine(str(folder))) as line:
        return train(config, env, folder, partners=partners, progress=line)
