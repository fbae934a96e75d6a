"""The scenes behave like the world: measured on MuJoCo itself, for every task. docs/environments.md
has the figures.
"""

import jax
import mujoco
import numpy as np
import pytest

from assistax_envs import TASKS
from assistax_envs.models import build_model
from assistax_envs.registered import TASK_CLASSES
from assistax_envs.tasks.base import ARM_SEGMENTS, ROBOT_JOINTS
from assistax_envs.tasks.bed_bath.task import arm_points
from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS
from tests.envs.base_scenes import BASES
from tests.envs.conftest import constant_actions, play, start

ARM_TASKS = (*PAPER_TASKS, *GENTLE_TASKS)

ARM_JOINTS = ("human_right_shoulder1", "human_right_shoulder2", "human_right_elbow")
SPEED_LIMITS = np.array([2.175] * 4 + [2.61] * 3)  # rad/s, of the Panda's datasheet


def _settled(task: str, seconds: float = 4.0) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = build_model(task)
    data = mujoco.MjData(model)
    data.qpos[:] = TASK_CLASSES[task](model).pose.angle
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return model, data


@pytest.mark.slow_for("bed_bath", "arm_assist")
@pytest.mark.parametrize(
    "task", [*PAPER_TASKS, *(pytest.param(task, marks=pytest.mark.slow) for task in GENTLE_TASKS)]
)
def test_resting_human_stays_at_rest(task: str) -> None:
    # 4 s of settling. Gentle lift's arm starts anywhere on its way and slides back, where gravity
    # nearly balances friction over 80 s (less by the factor e in 10 s).
    settling = 4000 if task == "gentle_lift" else 200
    actions = constant_actions(4, settling + 1000, 0.0, 0.0)
    states = play(task, "native", start(task, "native", ["d1"] * 4), actions)
    drift = np.abs(states[-1].physics.qpos - states[settling - 1].physics.qpos)  # in 20 s
    assert float(drift.max()) < 0.05


@pytest.mark.parametrize("task", ARM_TASKS)
def test_steady_contacts_barely_penetrate_and_carry_the_arm(task: str) -> None:
    model, data = _settled(task)
    assert data.ncon > 0
    assert data.contact.dist.min() > -0.005
    carried, weight = _contact_torque(model, data), _gravity_torque(model, data)
    dofs = [model.joint(name).dofadr[0] for name in ARM_JOINTS]
    limits = data.qfrc_constraint[dofs] - carried[dofs]  # what the elbow's stop adds
    balance = carried[dofs] + limits + data.qfrc_passive[dofs] - weight[dofs]
    assert np.abs(balance).max() < 0.1 * np.abs(weight[dofs]).max()
    assert (
        np.abs(carried[dofs]).max() > 0.3 * np.abs(weight[dofs]).max()
    )  # the furniture does carry it


@pytest.mark.parametrize("task", ARM_TASKS)
def test_falling_arm_gains_no_energy(task: str) -> None:
    model = build_model(task)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    data.qpos[:] = TASK_CLASSES[task](model).pose.angle
    data.qpos[model.joint("human_right_shoulder2").qposadr[0]] += 0.8  # lifted, then let go
    energies = []
    for _ in range(1000):
        mujoco.mj_step(model, data)
        energies.append(sum(data.energy))
    assert np.diff(energies[::20]).max() < 0.02  # J in 0.1 s
    assert energies[-1] < energies[0] - 0.5
    # m: by the thigh, mattress, over its edge
    below = {"scratch": 0.6, "bed_bath": 0.62, "arm_assist": 0.45}[BASES.get(task, task)]
    assert data.site("human_right_lower_arm").xpos[2] > below


@pytest.mark.parametrize("task", TASKS)
def test_full_torque_stays_within_the_panda_speed(task: str) -> None:
    model = build_model(task)
    for joint, limit in zip(ROBOT_JOINTS, SPEED_LIMITS, strict=True):
        data = mujoco.MjData(model)
        data.qpos[:] = TASK_CLASSES[task](model).pose.angle
        data.ctrl[model.actuator(joint).id] = 1.0
        fastest = 0.0
        for _ in range(200):
            mujoco.mj_step(model, data)
            fastest = max(fastest, abs(data.qvel[model.joint(joint).dofadr[0]]))
        assert fastest < limit


@pytest.mark.parametrize("task", ["scratch", "bed_bath"])
def test_tool_reaches_nearly_every_target(task: str) -> None:
    model = build_model(task)
    reached = [_nearest(model, task, seed) < 0.1 for seed in range(40)]
    assert np.mean(reached) > 0.95


def _contact_torque(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return the generalised force [nv] of all contacts, from their forces and Jacobians."""
    torque, force = np.zeros(model.nv), np.zeros(6)
    for index, contact in enumerate(data.contact):
        mujoco.mj_contactForce(model, data, index, force)
        world = contact.frame.reshape(3, 3).T @ force[:3]
        for geom, sign in ((contact.geom1, -1.0), (contact.geom2, 1.0)):
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, jacobian, None, contact.pos, model.geom_bodyid[geom])
            torque += sign * jacobian.T @ world
    return torque


def _gravity_torque(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return what must hold the arm up [nv]: weights times lever arms, from masses and positions
    alone.
    """
    torque = np.zeros(model.nv)
    for body in ("human_right_upper_arm", "human_right_lower_arm"):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jacBodyCom(model, data, jacobian, None, model.body(body).id)
        torque += jacobian.T @ np.array([0.0, 0.0, 9.81 * model.body(body).mass[0]])
    return torque


def _nearest(model: mujoco.MjModel, task: str, seed: int) -> float:
    """Return how near the tool gets to a drawn target by damped least squares from several starts,
    m.
    """
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    definition = TASK_CLASSES[task](model)
    qpos, state = definition.reset(jax.random.key(seed), None)
    data.qpos[:] = np.asarray(qpos)
    for joint in ARM_JOINTS if task == "scratch" else ():
        data.qpos[model.joint(joint).qposadr[0]] = rng.uniform(*model.joint(joint).range)
    mujoco.mj_kinematics(model, data)
    index = rng.integers(52)
    segments, offsets = arm_points(model)
    row, offset = (
        (int(state.segment), np.asarray(state.offset))
        if task == "scratch"
        else (int(segments[index]), offsets[index])
    )
    site = data.site(f"human_{ARM_SEGMENTS[row]}")
    target = site.xpos + site.xmat.reshape(3, 3) @ offset
    rows = [model.joint(name).qposadr[0] for name in ROBOT_JOINTS]
    dofs = [model.joint(name).dofadr[0] for name in ROBOT_JOINTS]
    low, high = np.array([model.joint(name).range for name in ROBOT_JOINTS]).T
    tool, best = model.site("robot_end_effector").id, np.inf
    for attempt in range(4):
        if attempt:
            data.qpos[rows] = rng.uniform(low, high)
        for _ in range(60):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            error = target - data.site_xpos[tool]
            best = min(best, float(np.linalg.norm(error)))
            if best < 0.05:
                return best
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, jacobian, None, tool)
            part = jacobian[:, dofs]
            step = part.T @ np.linalg.solve(part @ part.T + 1e-3 * np.eye(3), error)
            data.qpos[rows] = np.clip(data.qpos[rows] + 0.7 * step, low, high)
    return best
