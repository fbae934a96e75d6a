"""Touches of the gentle tasks: contacts of every physics step, limits, the protective stop."""

from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import assistax_envs
from assistax_envs.models import build_model
from assistax_envs.physics import SUBSTEPS, PhysicsState
from assistax_envs.physics.base import felt_sensors
from assistax_envs.tasks import gentle_base
from assistax_envs.tasks.base import HUMAN_JOINTS
from assistax_envs.tasks.care import IMPACT, NONE, PRESSED
from assistax_envs.tasks.chain import script_of
from tests.envs.conftest import environment
from tests.envs.fused.scenes import touching_states


@pytest.mark.parametrize("backend", ["native", "fused"])
def test_contacts_of_every_physics_step_count(backend: str) -> None:
    task = "gentle_lift"
    env, states = environment(task, backend), touching_states(task)
    model = env.model
    rows, pairs = slice(0, 64), len(felt_sensors(model))
    n = len(states.qpos[rows])
    still = jnp.zeros((n, model.nv), jnp.float32)
    physics = PhysicsState(jnp.asarray(states.qpos[rows], jnp.float32), still, still)
    ranges = jnp.broadcast_to(
        jnp.asarray(model.jnt_range, jnp.float32), (n, *model.jnt_range.shape)
    )
    control = jnp.zeros((n, model.nu), jnp.float32)
    # What the engine gives before a task reads it.
    _, values = env._physics.step(physics, control, ranges)
    last = np.asarray(values[:, : model.nsensordata])
    peaks = np.asarray(values[:, model.nsensordata :])
    assert peaks.shape == (n, pairs + 1)
    at = model.sensor_adr[felt_sensors(model)][:, None] + np.arange(3)
    size = np.linalg.norm(last[:, at], axis=-1)
    assert (peaks[:, :-1] >= size - 1e-3).all()
    assert (peaks[:, -1] >= size.sum(axis=1) - 1e-3).all()
    # Skin that was pressed in pushes back: the first steps' forces are larger than the last one's.
    data, largest = mujoco.MjData(model), np.zeros((n, pairs))
    for i in range(n):
        mujoco.mj_resetData(model, data)
        data.qpos[:] = states.qpos[rows][i]
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)
            largest[i] = np.maximum(largest[i], np.linalg.norm(data.sensordata[at], axis=-1))
    assert (largest.max(axis=1) > size.max(axis=1) + 1.0).sum() >= 3
    wrong = np.abs(peaks[:, :-1] - largest) / (1.0 + largest)
    assert np.median(wrong[largest > 1.0]) < 1e-2


@pytest.mark.slow
@pytest.mark.parametrize(("limits", "kind"), [("_limits", PRESSED), ("_impacts", IMPACT)])
def test_violation_ends_the_episode(limits: str, kind: int) -> None:
    task = "gentle_scratch"
    env: Any = assistax_envs.make(task, "native")
    # A limit that every touch breaks: half a second of touch, or the first one, is a violation.
    setattr(env._task.sensors, limits, np.full_like(env._task.sensors._limits, 1e-3))
    robot = script_of(task, env.model)
    state = jax.jit(env.reset)(
        jax.random.split(jax.random.key(0), 8), assistax_envs.disability_params(["d1"] * 8)
    )
    step, stopped, touched = jax.jit(env.step), np.zeros(8, bool), np.zeros(8, int)
    for _ in range(200):
        state = step(state, {"robot": robot(state.obs["robot"]), "human": jnp.zeros((8, 3))})
        touched += ~stopped & (np.asarray(state.measures.contact) > 1e-3)
        stopped |= np.asarray(state.terminated)
    assert env.stops and stopped.any()
    assert set(touched[stopped].tolist()) == {26 if kind == PRESSED else 1}
    np.testing.assert_array_equal(state.terminated, state.measures.violated)
    np.testing.assert_array_equal(state.measures.violation, np.where(stopped, kind, NONE))


def test_limits_are_those_of_the_touched_part() -> None:
    env: Any = environment("gentle_scratch", "native")
    # What readings are held against, by part.
    sensors, parts = env._task.sensors, _touched_parts(env.model)
    limits = dict(zip(parts, sensors._limits.tolist(), strict=True))
    impacts = dict(zip(parts, sensors._impacts.tolist(), strict=True))
    assert limits["human_head"] == 32.5 and limits["human_right_lower_arm"] == 80.0
    # ISO/TS 15066: twice the quasi-static limits for impacts, except at the face.
    assert impacts["human_head"] == 32.5 and impacts["human_right_lower_arm"] == 160.0


def test_another_version_is_refused() -> None:
    with pytest.raises(ValueError, match="gentle_scratch is 3; this installation plays version 4"):
        assistax_envs.make("gentle_scratch", "native", version=3)


def _touched_parts(model: mujoco.MjModel) -> list[str]:
    return [model.geom(int(model.sensor(i).refid[0])).name for i in felt_sensors(model)]


def test_head_distance_matches_mujoco() -> None:
    model, rng = build_model("gentle_scratch"), np.random.default_rng(2)
    data, joints = mujoco.MjData(model), [n for n in HUMAN_JOINTS if "abdomen" in n]
    for _ in range(5):
        angles = rng.uniform(-0.3, 0.3, 3)
        data.qpos[[model.joint(name).qposadr[0] for name in joints]] = angles
        mujoco.mj_kinematics(model, data)
        head, point = model.geom("human_head"), rng.uniform(-1.0, 1.0, 3)
        expected = np.linalg.norm(point - data.geom_xpos[head.id]) - head.size[0]
        # Its distance is a measure; here it is held against MuJoCo.
        near = gentle_base._Head(model).distance(
            jnp.asarray(angles, jnp.float32)[None], jnp.asarray(point, jnp.float32)[None]
        )
        np.testing.assert_allclose(near, [expected], atol=1e-5)
