"""What trainers and rollouts need of an environment, and those whose observations hold more."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.models.build import scene_sha256
from assistax_envs.preferences import WORDS
from assistax_envs.tasks.speech import told

TEACHER = "teacher"  # name of the observation that a teacher reads
EnvState = Any  # the environment's own state; axis N first in every leaf


class Environment(Protocol):
    """N simulations at once, never mapped over; `assistax_envs.Env` is one."""

    task: str
    backend: str
    version: int
    episode_length: int
    observation_size: dict[str, int]  # by role and "global"
    action_size: dict[str, int]  # by role

    def reset(self, keys: jax.Array, params: Any, /) -> EnvState: ...
    def step(self, state: EnvState, action: dict[str, jax.Array], /) -> EnvState: ...
    def joint_positions(self, state: EnvState, /) -> dict[str, jax.Array]: ...  # rad, by role


def environment_facts(env: Environment, packages: Mapping[str, str]) -> dict[str, Any]:
    """Return the facts, JSON-ready, that a run which goes on must share.

    Args:
        env: The environment.
        packages: Versions of the installed packages that the trainer uses, by package.
    """
    facts = {"packages": dict(packages)} if packages else {}
    return facts | {
        "version": env.version,
        "backend": env.backend,
        "engine": getattr(env, "engine", {}),
        "scene": scene_sha256(env.task),
    }


class ShowingMore:
    """An environment whose observations hold more than its own."""

    def __init__(self, env: Environment) -> None:
        self._env = env
        self.task, self.backend, self.version = env.task, env.backend, env.version
        self.episode_length, self.action_size = env.episode_length, env.action_size
        self.observation_size = dict(env.observation_size)

    def reset(self, keys: jax.Array, params: Any) -> EnvState:
        """Start episodes."""
        return self._shown(self._env.reset(keys, params))

    def step(self, state: EnvState, action: dict[str, jax.Array]) -> EnvState:
        """Advance by one step."""
        sizes = self._env.observation_size
        own = {name: state.obs[name][:, :size] for name, size in sizes.items()}
        return self._shown(self._env.step(dataclasses.replace(state, obs=own), action))

    def joint_positions(self, state: EnvState) -> dict[str, jax.Array]:
        """Return the joint angles of each role, rad."""
        return self._env.joint_positions(state)

    def _shown(self, state: EnvState) -> EnvState:
        raise NotImplementedError


class ToldNumbers(ShowingMore):
    """An environment whose robot observes the numbers of its person: a row to compare with.

    Args:
        env: The environment.
        rows: Of the persons [P, 30], as `EnvParams.person` counts them.

    Raises:
        ValueError: There are no persons.
    """

    def __init__(self, env: Environment, rows: np.ndarray | None) -> None:
        if rows is None:
            raise ValueError(
                "a robot is told its partner's numbers, and only persons have any; play it with "
                "persons alone"
            )
        super().__init__(env)
        self.engine = getattr(env, "engine", {})
        self._rows = np.asarray(rows)
        self.observation_size["robot"] += self._rows.shape[1]

    def _shown(self, state: EnvState) -> EnvState:
        told = jnp.asarray(self._rows)[state.params.person]
        robot = jnp.concatenate([state.obs["robot"], told], axis=-1)
        return dataclasses.replace(state, obs={**state.obs, "robot": robot})


class WithTeacher(ShowingMore):
    """An environment that also shows "teacher": the observation of a robot told the wishes.

    Args:
        env: The environment of a gentle task, whose robot is told nothing.
        width: Of that observation.

    Attributes:
        added: How many numbers a robot that is told the wishes observes beside the others.

    Raises:
        ValueError: No robot of the task that is told the wishes observes so many numbers.
    """

    def __init__(self, env: Environment, width: int) -> None:
        super().__init__(env)
        own = env.observation_size["robot"]
        self.added = width - own
        if not 0 < self.added <= env.observation_size["global"] - len(WORDS):
            raise ValueError(
                f"the teacher observes {width} numbers and a robot of {env.task} {own}; give a "
                "robot of this task that is told the preference"
            )
        self.observation_size[TEACHER] = width

    def _shown(self, state: EnvState) -> EnvState:
        return dataclasses.replace(state, obs={**state.obs, TEACHER: told(state.obs, self.added)})
