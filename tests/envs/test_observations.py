"""The robot sees its own joints, the human its own, and widths follow Table 4."""

import jax.numpy as jnp
import numpy as np

from assistax_envs.tasks.base import HUMAN_JOINTS, ROBOT_JOINTS, Sensors
from tests.envs.conftest import environment, native_and_mjx, play, random_actions, start

SETTINGS = ["d1", "d9", "d3", "d7"]


@native_and_mjx
def test_observation_slices_are_the_joints_of_mujoco_itself(backend: str) -> None:
    env = environment("scratch", backend)
    moving = play("scratch", backend, start("scratch", backend, SETTINGS), random_actions(4, 25))[
        -1
    ]
    state = start("scratch", backend, SETTINGS)
    robot = [env.model.joint(name).qposadr[0] for name in ROBOT_JOINTS]
    human = [env.model.joint(name).qposadr[0] for name in HUMAN_JOINTS]
    qpos = np.asarray(state.physics.qpos)
    np.testing.assert_allclose(state.obs["robot"][:, :7], qpos[:, robot], atol=1e-6)
    np.testing.assert_allclose(state.obs["human"][:, :9], qpos[:, human], atol=1e-6)
    # After a step, sensors are one substep of 5 ms older than the state.
    past = np.asarray(moving.physics.qpos) - 0.005 * np.asarray(moving.physics.qvel)
    np.testing.assert_allclose(moving.obs["robot"][:, :7], past[:, robot], atol=1e-3)
    np.testing.assert_allclose(moving.obs["human"][:, :9], past[:, human], atol=1e-3)
    speeds = [env.model.joint(name).dofadr[0] for name in ROBOT_JOINTS]
    assert (
        np.corrcoef(
            moving.obs["robot"][:, 7:14].ravel(), np.asarray(moving.physics.qvel)[:, speeds].ravel()
        )[0, 1]
        > 0.9
    )


def test_joints_resolve_by_name_wherever_they_stand() -> None:
    model = environment("scratch", "native").model
    sensors = Sensors(model)
    values = jnp.arange(model.nsensordata, dtype=jnp.float32)[None]
    readings = sensors.read(values)
    for i, joint in enumerate(ROBOT_JOINTS):
        assert readings.robot_position[0, i] == model.sensor(f"{joint}_position").adr[0]
        assert model.sensor(f"{joint}_position").objid[0] == model.joint(joint).id
    for i, joint in enumerate(HUMAN_JOINTS):
        assert readings.human_velocity[0, i] == model.sensor(f"{joint}_velocity").adr[0]
        assert model.sensor(f"{joint}_velocity").objid[0] == model.joint(joint).id


def test_target_lies_on_the_moving_skin() -> None:
    env = environment("scratch", "native")
    state = start("scratch", "native", ["d1"] * 64, seed=11)
    obs = np.asarray(state.obs["robot"])
    target = obs[:, 14:17] + obs[:, 30:33]
    np.testing.assert_allclose(np.linalg.norm(obs[:, 30:33], axis=-1), obs[:, 33], rtol=1e-5)
    segment = np.asarray(state.task.segment)
    assert set(segment.tolist()) == {0, 1}
    centre = np.where(segment[:, None] == 1, obs[:, 24:27], obs[:, 27:30])
    radius, half = (
        np.array([env.model.site(f"human_right_{s}_arm").size[i] for s in ("upper", "lower")])
        for i in (0, 1)
    )
    along = np.sqrt(
        np.sum((target - centre) ** 2, -1) - radius[segment] ** 2
    )  # Pythagoras on the capsule's side
    assert np.all(along <= half[segment] + 1e-4)
    assert along.max() > 0.8 * half.max()
