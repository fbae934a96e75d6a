"""Humans of a few lines, for tests of the tasks at the mouth; and where scripted pairs took them.

    python -m tests.envs.mouth TASK ...

writes `fused/TASK_states.npz`: states that a scripted pair visits, and the torques there.
"""

import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, EnvState, disability_params, make
from assistax_envs.models.care_scenes import OPEN
from assistax_envs.models.teeth import INNER, SHOWN_BY
from assistax_envs.preferences import PREFERENCES
from assistax_envs.tasks.chain import script_of
from assistax_envs.tasks.mouth import TAKING, TURNED, WAITING
from tests.envs.conftest import compiled, environment

STATES = Path(__file__).parent / "fused"
SIMULATIONS, STEPS, TIMES = 72, 400, (60, 140, 230, 399)
# Columns of a human's observation of gentle feeding.
OUT, JAW, STAGES, SHUT = 30, 36, slice(37, 42), 42
WIDE, NARROW = 0.42, 0.05  # rad
# The same of gentle brushing, and the neck's spring and torque.
BRUSHED_JAW, PLACE = 48, slice(50, 62)
NECK_SPRING, NECK_TORQUE = 3.0, 1.8  # N m/rad, N m
SPRING, HOLDS, TORQUE = 0.8, 0.19, 0.8  # N m/rad, N m: the jaw's, as in `care_scenes`


class LaidOut:
    """One simulation of a task, whose readings a test lays out by hand; `begun` is its start."""

    def __init__(self, task: str, preference: str) -> None:
        env = environment(task, "native")
        # The task itself, whose terms are compared.
        self.task: Any = env._task
        params = disability_params(["d1"], [preference])
        begun = compiled(task, "native")[0](jax.random.split(jax.random.key(0), 1), params)
        self.preference, self.begun = PREFERENCES[preference], begun.task
        # Readings as the environment makes them, of a state that is set by hand.
        ranges = env._joint_range(params)
        self.read = env._sensors.read(env._physics.forward(begun.physics, ranges))
        self.state: Any = self.begun
        self.total, self._transition = 0.0, jax.jit(self.task.transition)

    def after(self, readings: Any, steps: int) -> dict[str, float]:
        """Return the weighted terms, summed over equal steps."""
        sums = dict.fromkeys(self.task.weights, 0.0)
        for _ in range(steps):
            self.state, _, terms, self.measures = self._transition(self.state, readings)
            for name, weight in self.task.weights.items():
                sums[name] += weight * float(terms[name][0])
        self.total += sum(sums.values())
        return sums


def eats(obs: jax.Array) -> jax.Array:
    """Open for a spoon that waits, close on it, and let it go: actions [N, 5]."""
    jaw, out = obs[:, JAW] * OPEN, obs[:, OUT] / 10.0
    stage = obs[:, STAGES].argmax(axis=1)
    waits = (stage == WAITING) & ((obs[:, SHUT] < 0.5) | (out > 0.12))
    wanted = jnp.where(waits | (stage == TAKING), NARROW, WIDE)
    torque = HOLDS + SPRING * wanted + 2.0 * (wanted - jaw)
    return jnp.zeros((obs.shape[0], 5)).at[:, 4].set(jnp.clip(torque / TORQUE, -0.2, 1.0))


def shows(obs: jax.Array) -> jax.Array:
    """Turn the head to show the side that is to be brushed, open for the inside: actions [N, 5]."""
    place = obs[:, PLACE]
    turn = TURNED * place @ jnp.asarray(SHOWN_BY, jnp.float32)
    wanted = jnp.where(place @ jnp.asarray(INNER, jnp.float32) > 0.5, WIDE, 0.0)
    jaw, yaw = obs[:, BRUSHED_JAW] * OPEN, obs[:, BRUSHED_JAW + 1]
    torque = HOLDS + SPRING * wanted + 2.0 * (wanted - jaw)
    torque = jnp.where(wanted > 0.0, torque, 0.0)
    neck = (NECK_SPRING * turn + 2.0 * (turn - yaw)) / NECK_TORQUE
    actions = jnp.zeros((obs.shape[0], 5)).at[:, 4].set(jnp.clip(torque / TORQUE, -0.2, 1.0))
    return actions.at[:, 2].set(jnp.clip(neck, -1.0, 1.0))


HUMANS = {"gentle_feeding": eats, "gentle_brushing": shows}


def meal(
    env: Env, simulations: int, steps: int, seed: int = 0, human=None
) -> tuple[EnvState, EnvState]:
    """Return the first state of an episode with the script and all states [T, N, ...] after it."""
    robot, human = script_of(env.task, env.model), human or HUMANS[env.task]
    keys = jax.random.split(jax.random.key(seed), simulations)
    start = jax.jit(env.reset)(keys, disability_params(["d1"] * simulations))

    def step(state: EnvState, _: None) -> tuple[EnvState, EnvState]:
        action = {"robot": robot(state.obs["robot"]), "human": human(state.obs["human"])}
        after = env.step(state, action)
        return after, after

    return start, jax.jit(lambda state: jax.lax.scan(step, state, None, steps))(start)[1]


def write_states(task: str) -> None:
    env, human = make(task, "fused"), HUMANS[task]
    _, states = meal(env, SIMULATIONS, STEPS)
    at = np.array(TIMES)
    qpos, qvel = (
        np.concatenate(np.asarray(x)[at]) for x in (states.physics.qpos, states.physics.qvel)
    )
    robot = script_of(task, env.model)
    ctrl = np.zeros((len(qpos), env.model.nu), np.float32)
    driven = [env.model.actuator(i).name.startswith("robot_") for i in range(env.model.nu)]
    seen = {role: np.concatenate(np.asarray(states.obs[role])[at]) for role in ("robot", "human")}
    ctrl[:, driven] = np.clip(robot(jnp.asarray(seen["robot"])), -1.0, 1.0)
    ctrl[:, ~np.array(driven)] = np.clip(human(jnp.asarray(seen["human"])), -1.0, 1.0)
    np.savez_compressed(STATES / f"{task}_states.npz", qpos=qpos, qvel=qvel, ctrl=ctrl)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write_states(name)
