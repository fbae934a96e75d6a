"""Prints how near the fused engine is to converged MuJoCo, as the table of docs/log/engine.md.

    python -m tests.envs.fused.accuracy

Relative errors are of the change of the velocities in a control step, whose size is taken to be at
least 0.01 rad/s; `moved` is converged MuJoCo from angles that differ by 1e-7 rad, `4 iterations`
is MuJoCo as the scenes ask for it. The last columns are of joint angles after 20 control steps.
"""

import copy

import mujoco
import numpy as np

from tests.envs.fused.scenes import TASKS, States, engine, oracle, scene, team_states

SUBSTEPS, STEPS, N = 4, 20, 288


def as_asked(model: mujoco.MjModel, states: States, substeps: int, ranges: np.ndarray):
    """Return angles and velocities of MuJoCo at the iterations that the scene asks for."""
    model = copy.copy(model)
    data, results = mujoco.MjData(model), []
    for i in range(len(states)):
        mujoco.mj_resetData(model, data)
        model.jnt_range[:] = ranges[i]
        data.qpos[:], data.qvel[:], data.ctrl[:] = states.qpos[i], states.qvel[i], states.ctrl[i]
        mujoco.mj_step(model, data, substeps)
        results.append((data.qpos.copy(), data.qvel.copy()))
    return tuple(map(np.array, zip(*results, strict=True)))


def moved(states: States) -> States:
    other = copy.copy(states)
    other.qpos = states.qpos.astype(float) + 1e-7
    return other


def rolled(task: str, states: States, ranges: np.ndarray) -> np.ndarray:
    for _ in range(STEPS):
        qpos, qvel, _ = engine(task)(states, SUBSTEPS, ranges)
        states = States(qpos, qvel, states.ctrl)
    return states.qpos


def quantiles(error: np.ndarray) -> str:
    return " / ".join(f"{x:.0e}" for x in (np.median(error), np.quantile(error, 0.9), error.max()))


def row(task: str, name: str, step: np.ndarray, angles: np.ndarray) -> str:
    return f"| {task} | {name} | {quantiles(step)} | {quantiles(angles)} |"


def main() -> None:
    print("| scene | what | one control step | angles after 20, rad |\n| --- | --- | --- | --- |")
    for task in TASKS:
        model, (states, ranges) = scene(task), team_states(task)
        states, ranges = states[:N], ranges[:N]
        want = oracle(model, states, SUBSTEPS, ranges)[1]
        change = np.maximum(np.linalg.norm(want - states.qvel, axis=1), 0.01)
        far = oracle(model, states, SUBSTEPS * STEPS, ranges)[0]
        cases = {
            "fused": (engine(task)(states, SUBSTEPS, ranges)[1], rolled(task, states, ranges)),
            "moved": (
                oracle(model, moved(states), SUBSTEPS, ranges)[1],
                oracle(model, moved(states), SUBSTEPS * STEPS, ranges)[0],
            ),
            "4 iterations": (
                as_asked(model, states, SUBSTEPS, ranges)[1],
                as_asked(model, states, SUBSTEPS * STEPS, ranges)[0],
            ),
        }
        for name, (velocity, angles) in cases.items():
            error = np.linalg.norm(velocity - want, axis=1) / change
            print(row(task, name, error, np.abs(angles - far).max(axis=1)))


if __name__ == "__main__":
    main()
