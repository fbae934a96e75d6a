"""Robots that learn with persons: is it worth to be told, or to remember?

Three kinds of robot are trained with the training side's persons, a new one each episode, and play
with persons that they never met: PPO, PPO that is told the person's wishes, and PPO with a memory.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_base.files import write_json
from assistax_envs import Env, make
from assistax_envs.persons import PersonPlayer, numbers, person_params, persons
from evaluation.figures.bootstrap import Estimate, estimate
from evaluation.figures.metrics import paired_difference
from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import PPOConfig
from population.networks.policy import Policy
from population.play.rollout import Rollout
from population.runs.train import initial_state, make_trainer
from population.trainers.drawn_persons import DrawnPersons

# Robots by name: what the environment tells them, and what the trainer changes. The first is what
# the others are held against.
ROBOTS: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "ppo": (("human",), {}),
    "told": (("human", "robot"), {}),
    "gru": (("human",), {"torso": "gru"}),
}
# Sides of persons that no robot met, by name: the first number, how far apart, and the family.
STRANGERS = {
    "validation": (9, 10, "spring"),
    "corners": (8000, 1, "spring"),
    "muscle": (9000, 1, "muscle"),
}
SIDE = 200  # persons of each
EPISODES = 2  # with each of them
RESULT = "persons.json"


def train_with_persons(
    task: str,
    folder: Path,
    *,
    seeds: Sequence[int] = range(4),
    steps: int = 24_000_000,
    num_envs: int = 2048,
    backend: str = "auto",
    horizon: int | None = None,
    progress: Callable[[str], None] = print,
) -> dict[str, Any]:
    """Train each kind of robot, play it with strangers, and write what they earn.

    Args:
        task: Gentle task.
        folder: Gets `persons.json`.
        seeds: Of the robots.
        steps: Environment steps of each robot.
        num_envs: Simulations of each robot.
        backend: Physics.
        horizon: Steps of an episode with strangers; the environment's if not given.
        progress: Called with a line after each kind of robot and side of strangers.

    Returns:
        Returns [seed][person] and shares of safe success, by robot and side.
    """
    rows = persons(task)
    met = rows[numbers("training")]
    earned: dict[str, Any] = {}
    for name, (told, changes) in ROBOTS.items():
        env = make(task, backend, told=told)
        config = PPOConfig(num_envs=num_envs, learning_rate=5e-4, anneal_lr=True, **changes)
        partners = DrawnPersons(PersonPlayer(task), met, "persons")
        policy, params = _train(env, partners, config, seeds, steps)
        earned[name] = {}
        for side, (first, apart, family) in STRANGERS.items():
            strangers = rows[first::apart][:SIDE]
            earned[name][side] = _play(env, policy, params, strangers, family, horizon)
            progress(_line(earned, name, side))
    write_json(folder / RESULT, earned)
    return earned


def _train(
    env: Env, partners: DrawnPersons, config: PPOConfig, seeds: Sequence[int], steps: int
) -> tuple[Policy, Any]:
    """Return the robots' network and their parameters, leaves [M, ...]."""
    members = tuple(Member(seed, MIXED) for seed in seeds)
    run = TrainConfig(env.task, "ippo", members, steps, config, partners=partners.ids)
    trainer: Any = make_trainer(run, env, partners)
    state, hyper = initial_state(run, trainer), trainer.hyper(members)
    update = jax.jit(trainer.update, donate_argnums=0)
    for _ in range(run.updates):
        state, _ = update(state, hyper, partners.params)
    return trainer.policies["robot"], trainer.policy_params(state.members)["robot"]


def _play(
    env: Env, policy: Policy, params: Any, rows: np.ndarray, family: str, horizon: int | None
) -> dict[str, Any]:
    """Return what robots [M] earn with persons [P]: their returns and shares of safe success."""
    rollout = Rollout(env, [policy], [PersonPlayer(env.task, family)], length=horizon)
    keys = jax.random.split(jax.random.key(99), (len(rows), EPISODES))
    body, stack = person_params(env.task, rows), {"row": jnp.asarray(rows)}
    tally = rollout.run([params], [stack], body, keys)  # [M, P, K]
    safe = tally.success & ~tally.violated
    return {
        "return": np.asarray(tally.returns, np.float64).mean(axis=-1).tolist(),
        "safe_success": np.asarray(safe, np.float64).mean(axis=-1).tolist(),
    }


def _line(earned: dict[str, Any], name: str, side: str) -> str:
    """Return what a kind of robot earns with a side, and more than the first kind."""
    scores = np.array(earned[name][side]["return"])
    safe = np.mean(earned[name][side]["safe_success"])
    text = f"{name} with {side}: {_shown(estimate(scores))}, safe success {safe:.0%}"
    first = next(iter(earned))
    if name == first:
        return text
    difference = paired_difference(scores, np.array(earned[first][side]["return"]))
    return f"{text}, more than {first} by {_shown(difference)}"


def _shown(value: Estimate) -> str:
    low, high = value.mean_ci or (np.nan, np.nan)
    return f"{value.mean:.1f} [{low:.1f}, {high:.1f}]"
