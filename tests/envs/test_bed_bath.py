"""Bed bath: the points of the bath, their order, and Table 5."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.tasks.base import REACH, Readings, Sensors, rotate
from assistax_envs.tasks.bed_bath.task import POINTS, BedBath, BedBathState
from tests.envs.conftest import environment, start


def _readings() -> Readings:
    env = environment("bed_bath", "native")
    state = start("bed_bath", "native", ["d1"])
    # Readings of a state: an environment returns observations alone.
    values = env._physics.forward(state.physics, env._joint_range(state.params))
    return Sensors(env.model).read(values)


def _task() -> BedBath:
    return BedBath(environment("bed_bath", "native").model)


def _touching(readings: Readings, point: jax.Array, force: float) -> Readings:
    return dataclasses.replace(
        readings, tool_position=point, tool_force=jnp.array([[force, 0.0, 0.0]])
    )


def test_points_lie_on_the_skin() -> None:
    task, readings = _task(), _readings()
    model = environment("bed_bath", "native").model
    points = task.targets(BedBathState(jnp.full(1, -1, jnp.int32)), readings)["to wipe"][0]
    assert points.shape == (POINTS, 3)
    for row, segment in enumerate(("upper", "lower")):
        radius, half = model.site(f"human_right_{segment}_arm").size[:2]
        axis = rotate(readings.arm_orientation[0, row], jnp.array([0.0, 0.0, 1.0]))
        part = np.asarray(points[row * 26 : row * 26 + 26] - readings.arm_position[0, row][None])
        along = part @ np.asarray(axis)
        np.testing.assert_allclose(
            np.linalg.norm(part - along[:, None] * np.asarray(axis), axis=-1), radius, atol=1e-5
        )
        np.testing.assert_allclose(along, np.linspace(-half, half, 26), atol=1e-5)


def test_perfect_bath_earns_the_paper_bound() -> None:
    task, readings = _task(), _readings()

    def wipe(state: BedBathState, _: None) -> tuple[BedBathState, tuple[jax.Array, jax.Array]]:
        point = task.targets(state, readings)["next"][:, 0]
        state, _obs, terms, measures = task.transition(state, _touching(readings, point, 1.0))
        return state, (terms["reach_target"] + terms["wipe"], measures.success)

    first = BedBathState(jnp.zeros(1, jnp.int32))
    last, (reward, success) = jax.jit(lambda state: jax.lax.scan(wipe, state, length=1000))(first)
    assert round(float(reward.sum())) == 1052
    assert int(last.wiped[0]) == POINTS
    assert success[:, 0].tolist() == [False] * (POINTS - 1) + [True] * (1000 - POINTS + 1)


@pytest.mark.parametrize(
    ("away", "force", "wiped"), [(0.0, 1.0, 1), (0.0, 0.0, 0), (REACH + 0.01, 1.0, 0)]
)
def test_touch_within_reach_alone_wipes_a_point(away: float, force: float, wiped: int) -> None:
    task, readings = _task(), _readings()
    state = BedBathState(jnp.zeros(1, jnp.int32))
    point = task.targets(state, readings)["next"][:, 0] + jnp.array([[0.0, 0.0, away]])
    state, obs, terms, _ = task.transition(state, _touching(readings, point, force))
    assert (int(state.wiped[0]), float(terms["wipe"][0])) == (wiped, float(wiped))
    after = task.targets(state, readings)["next"][:, 0]
    np.testing.assert_allclose(
        obs["robot"][:, 30:33], after - point, atol=1e-6
    )  # the next target is seen at once
