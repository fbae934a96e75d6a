"""Untrained teams, for tests that need a registry and no skill."""

import dataclasses
import functools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax
import numpy as np

import assistax_envs
from assistax_envs.versions import VERSIONS
from assistax_workshop.press.publish import publish
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.runs.trained import TrainedTeam

ROBOT = PolicySpec("robot", observation_size=34, action_size=7, hidden=(8,))
HUMAN = PolicySpec("human", observation_size=38, action_size=3, hidden=(8,))


def params_of(spec: PolicySpec, seed: int) -> dict[str, Any]:
    return jax.tree.map(
        lambda leaf: np.array(leaf), jax.jit(Policy(spec).init)(jax.random.key(seed))
    )


def gentle_specs(task: str) -> tuple[PolicySpec, PolicySpec]:
    """Return what a robot and a human of a gentle task are."""
    env = assistax_envs.make(task, backend="native")
    robot, human = (
        PolicySpec(role, env.observation_size[role], env.action_size[role], hidden=(8,))
        for role in ("robot", "human")
    )
    return robot, human


def untrained_team(
    disability: str, seed: int, task: str = "scratch", **policies: tuple[PolicySpec, Any]
) -> TrainedTeam:
    """Return an IPPO team of policies by role: spec and parameters of each."""
    specs, params = ({role: pair[place] for role, pair in policies.items()} for place in range(2))
    training = {
        "run": "untrained",
        "steps": 0,
        "env_version": VERSIONS[task],
        "backend": "native",
    }
    return TrainedTeam(task, "ippo", disability, seed, specs, params, training)


def teams_of(
    seeds: int, robot: PolicySpec = ROBOT, human: PolicySpec = HUMAN, task: str = "scratch"
) -> list[TrainedTeam]:
    """Return untrained teams of d1 and d9, so many seeds of each."""
    return [
        untrained_team(
            disability,
            seed,
            task,
            robot=(robot, params_of(robot, 10 * place + seed)),
            human=(human, params_of(human, 100 + 10 * place + seed)),
        )
        for place, disability in enumerate(("d1", "d9"))
        for seed in range(seeds)
    ]


def halved(teams: Iterable[TrainedTeam]) -> list[TrainedTeam]:
    """Return teams of the same ids with other parameters."""
    half = functools.partial(jax.tree.map, lambda leaf: leaf / 2)
    return [dataclasses.replace(team, params=half(team.params)) for team in teams]


def published(teams: Iterable[TrainedTeam], folder: Path) -> Path:
    """Publish teams in a release v0, and return the registry's path."""
    path = folder / "registry.json"
    publish(list(teams), path, "v0", date="2026-01-01")
    return path
