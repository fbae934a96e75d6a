"""Writes team_states.npz: states that trained teams of the zoo visit, with the controls they give.

    python -m tests.envs.fused.make_team_states

For each task nine published teams, of as many disability settings as there are, play eight
simulations on the native backend, each of which is looked at in four of its first 200 steps.
Arrays, by task: `qpos`, `qvel`, `ctrl` and the right elbow's range `elbow`, float32 [288, ...].
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import assistax_envs
from assistax_envs import disability_params
from assistax_envs.versions import PAPER_TASKS
from tests.envs.teams import team
from zoo.registry import load_registry
from zoo.schema import PolicyEntry

PATH = Path(__file__).with_name("team_states.npz")
TEAMS, SIMULATIONS, STEPS, TIMES = 9, 8, 200, (20, 70, 130, 199)


def teams(task: str) -> list[PolicyEntry]:
    """Return the robots of nine teams, of as many settings as there are."""
    robots = load_registry().select(task=task, algorithm="ippo", role="robot")
    of_setting = {robot.disability: robot for robot in robots}
    others = [robot for robot in robots if robot not in of_setting.values()]
    return [*of_setting.values(), *others][:TEAMS]


def visited(robot: PolicyEntry) -> dict[str, np.ndarray]:
    """Return the states of one team, simulations in a row and times in columns, flattened."""
    env = assistax_envs.make(robot.task, "native")
    act = team(robot.id.removesuffix("/robot"), SIMULATIONS)
    params = disability_params([robot.disability] * SIMULATIONS)
    start = env.reset(jax.random.split(jax.random.key(7), SIMULATIONS), params)

    def step(state, time):
        action = act(state, time)
        given = state.tremor, state.key, state.step, state.params.tremor
        # No state keeps the tremor's torque,
        shake = env._tremor.shake(*given)[1]
        # nor the engine's input of this step.
        control = env._control(state.params, action, shake)
        seen = state.physics.qpos, state.physics.qvel, control
        return env.step(state, action), seen

    _, seen = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(STEPS)))(start)
    qpos, qvel, ctrl = (np.concatenate(np.asarray(x)[list(TIMES)]) for x in seen)
    # The engine's input too.
    elbow = np.tile(np.asarray(env._joint_range(params))[:, env._stiff[0]], (len(TIMES), 1))
    return {"qpos": qpos, "qvel": qvel, "ctrl": ctrl, "elbow": elbow}


if __name__ == "__main__":
    arrays: dict[str, np.ndarray] = {}
    for task in PAPER_TASKS:
        states = [visited(robot) for robot in teams(task)]
        for name in states[0]:
            arrays[f"{task}_{name}"] = np.concatenate([part[name] for part in states])
    np.savez_compressed(PATH, **arrays)
    print(PATH, PATH.stat().st_size)
