"""A human that eats by a few lines, for tests of the tasks at the mouth; and where they took it.

    python -m tests.envs.mouth

writes `fused/mouth_states.npz`: states that a scripted pair visits, and the torques there.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import Env, EnvState, disability_params, make
from assistax_envs.scripted import scripted_robot
from assistax_envs.tasks.gentle_feeding import OPEN, TAKING, WAITING

STATES = Path(__file__).parent / "fused" / "mouth_states.npz"
SIMULATIONS, STEPS, TIMES = 72, 400, (60, 140, 230, 399)
# Columns of a human's observation of gentle feeding.
OUT, JAW, STAGES, SHUT = 30, 36, slice(37, 42), 42
WIDE, NARROW = 0.42, 0.05  # rad
SPRING, HOLDS, TORQUE = 0.8, 0.19, 0.8  # N m/rad, N m: the jaw's, as in `care_scenes`


def eats(obs: jax.Array) -> jax.Array:
    """Open for a spoon that waits, close on it, and let it go: actions [N, 5]."""
    jaw, out = obs[:, JAW] * OPEN, obs[:, OUT] / 10.0
    stage = obs[:, STAGES].argmax(axis=1)
    waits = (stage == WAITING) & ((obs[:, SHUT] < 0.5) | (out > 0.12))
    wanted = jnp.where(waits | (stage == TAKING), NARROW, WIDE)
    torque = HOLDS + SPRING * wanted + 2.0 * (wanted - jaw)
    return jnp.zeros((obs.shape[0], 5)).at[:, 4].set(jnp.clip(torque / TORQUE, -0.2, 1.0))


def meal(
    env: Env, simulations: int, steps: int, seed: int = 0, human=eats
) -> tuple[EnvState, EnvState]:
    """Return the first state of a meal with the script and all states [T, N, ...] after it."""
    robot = scripted_robot("gentle_feeding", env.model)
    keys = jax.random.split(jax.random.key(seed), simulations)
    start = jax.jit(env.reset)(keys, disability_params(["d1"] * simulations))

    def step(state: EnvState, _: None) -> tuple[EnvState, EnvState]:
        action = {"robot": robot(state.obs["robot"]), "human": human(state.obs["human"])}
        after = env.step(state, action)
        return after, after

    return start, jax.jit(lambda state: jax.lax.scan(step, state, None, steps))(start)[1]


def write_states() -> None:
    env = make("gentle_feeding", "fused")
    _, states = meal(env, SIMULATIONS, STEPS)
    at = np.array(TIMES)
    qpos, qvel = (
        np.concatenate(np.asarray(x)[at]) for x in (states.physics.qpos, states.physics.qvel)
    )
    robot = scripted_robot("gentle_feeding", env.model)
    ctrl = np.zeros((len(qpos), env.model.nu), np.float32)
    driven = [env.model.actuator(i).name.startswith("robot_") for i in range(env.model.nu)]
    seen = {role: np.concatenate(np.asarray(states.obs[role])[at]) for role in ("robot", "human")}
    ctrl[:, driven] = np.clip(robot(jnp.asarray(seen["robot"])), -1.0, 1.0)
    ctrl[:, ~np.array(driven)] = np.clip(eats(jnp.asarray(seen["human"])), -1.0, 1.0)
    np.savez_compressed(STATES, qpos=qpos, qvel=qvel, ctrl=ctrl)


if __name__ == "__main__":
    write_states()
