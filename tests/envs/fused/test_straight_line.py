"""The straight-line code, run in double precision with NumPy, topic by topic against MuJoCo."""

import copy

import mujoco
import numpy as np
import pytest

from assistax_envs.physics.fused.expressions import Value
from assistax_envs.physics.fused.factorisation import entry_order
from assistax_envs.physics.fused.program import Dynamics, derive
from tests.envs.fused.scenes import TASKS, random_states, scene

N = 20


class Run:
    """A task's straight-line code at random states, and MuJoCo's data at each of them.

    `planted`, if given, is what the code is derived from instead of the task's model.
    """

    def __init__(self, task: str, planted: mujoco.MjModel | None = None) -> None:
        self.task = task
        self.model = scene(task)
        self.dynamics: Dynamics = derive(planted or self.model)
        self.states = random_states(self.model, 4 * N, seed=1)[:N]
        self.data = [self._mujoco(i) for i in range(N)]
        inputs = {f"q[{k}]": self.states.qpos[:, k].astype(float) for k in range(self.model.nq)}
        inputs |= {f"qd[{k}]": self.states.qvel[:, k].astype(float) for k in range(self.model.nv)}
        inputs |= {f"u[{k}]": self.states.ctrl[:, k].astype(float) for k in range(self.model.nu)}
        inputs |= {f"lo[{k}]": x for k, x in enumerate(self.model.jnt_range[:, 0])}
        inputs |= {f"hi[{k}]": x for k, x in enumerate(self.model.jnt_range[:, 1])}
        inputs |= {f"sensed[{k}]": np.zeros(N) for k in range(9 * self.model.nsensor)}
        torques = np.random.default_rng(2).normal(size=(self.model.nv, N))
        self.torques = torques
        inputs |= {f"torque[{k}]": torques[k] for k in range(self.model.nv)}
        self.values = self.dynamics.block.evaluate(inputs)

    def _mujoco(self, i: int) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        data.qpos[:], data.qvel[:] = self.states.qpos[i], self.states.qvel[i]
        data.ctrl[:] = self.states.ctrl[i]
        mujoco.mj_forward(self.model, data)
        return data

    def number(self, x: Value | float) -> np.ndarray:
        return np.broadcast_to(self.values[x.name] if isinstance(x, Value) else x, N)

    def array(self, values) -> np.ndarray:
        """Return [N, ...] of nested lists of values."""
        if isinstance(values, list | tuple):
            return np.stack([self.array(value) for value in values], axis=1)
        return self.number(values)


@pytest.fixture(scope="module", params=TASKS)
def run(request: pytest.FixtureRequest) -> Run:
    return Run(request.param)


def test_kinematics(run: Run) -> None:
    for link, pose in zip(run.dynamics.tree.links, run.dynamics.poses, strict=True):
        anchors = np.array([data.xanchor[link.dof] for data in run.data])
        axes = np.array([data.xaxis[link.dof] for data in run.data])
        origin = run.dynamics.tree.origins[link.tree]
        np.testing.assert_allclose(run.array(pose.position) + origin, anchors, atol=1e-12)
        np.testing.assert_allclose(run.array(pose.axis), axes, atol=1e-12)
        rotation = run.array([list(row) for row in pose.rotation])
        unit = np.einsum("nij,nkj->nik", rotation, rotation)
        np.testing.assert_allclose(unit, np.broadcast_to(np.eye(3), (N, 3, 3)), atol=1e-12)


def test_inertia_matrix(run: Run) -> None:
    for i, j in entry_order(run.dynamics.tree.parents):
        want = []
        for data in run.data:
            full = np.zeros((run.model.nv, run.model.nv))
            mujoco.mj_fullM(run.model, data, full)
            want.append(full[i, j])
        np.testing.assert_allclose(run.number(run.dynamics.matrix[i, j]), want, atol=1e-11)


def test_forces(run: Run) -> None:
    want = np.array([data.qfrc_smooth for data in run.data])
    np.testing.assert_allclose(run.array(run.dynamics.forces), want, rtol=1e-10, atol=1e-10)


def test_accelerations_are_those_of_implicitfast(run: Run) -> None:
    model, got = run.model, run.array(run.dynamics.accelerations)
    for i, data in enumerate(run.data):
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        full += model.opt.timestep * np.diag(model.dof_damping)
        np.testing.assert_allclose(got[i], np.linalg.solve(full, run.torques[:, i]), rtol=1e-9)


def test_gaps_have_the_sign_of_the_distance(run: Run) -> None:
    dynamics, model = run.dynamics, run.model
    for place, gap in zip(dynamics.places, dynamics.gaps, strict=True):
        ids = place.first.id, place.second.id
        for i, data in enumerate(run.data):
            touching = any(set(contact.geom) == set(ids) for contact in data.contact)
            if not place.end:
                assert (run.number(gap)[i] < 0) == touching, (model.geom(ids[0]).name, i)
            elif run.number(gap)[i] < 0:
                assert touching


def test_sensors(run: Run) -> None:
    want = np.array([data.sensordata for data in run.data])
    contact = run.model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
    keep = np.repeat(~contact, run.model.sensor_dim)
    got = run.array(run.dynamics.sensors)
    np.testing.assert_allclose(got[:, keep], want[:, keep], atol=1e-12)
    assert keep.sum() > 50


NUMBERS = ["body_mass", "body_inertia", "actuator_gear", "dof_damping", "dof_armature"]


@pytest.mark.parametrize(
    "field", ["jnt_stiffness", *(pytest.param(name, marks=pytest.mark.slow) for name in NUMBERS)]
)
def test_one_percent_of_any_one_number_is_seen(field: str) -> None:
    true = Run("arm_assist")
    planted = copy.copy(true.model)
    values = getattr(planted, field)
    moves = planted.body_weldid != 0 if field.startswith("body") else np.ones(len(values), bool)
    for index in np.flatnonzero(values.reshape(len(values), -1)[:, 0] * moves):
        before = values[index].copy()
        values[index] = 1.01 * before
        wrong = Run("arm_assist", planted)
        values[index] = before
        with pytest.raises(AssertionError):
            test_inertia_matrix(wrong)
            test_forces(wrong)
            test_accelerations_are_those_of_implicitfast(wrong)
