"""What gentle lift and gentle bath pay for, and where their episodes start.

Readings are made by hand: the arm and the tool are put where a test needs them.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from assistax_envs.preferences import PREFERENCES
from assistax_envs.tasks.base import HUMAN_ACTUATORS
from assistax_envs.tasks.gentle_base import TouchReadings
from assistax_envs.tasks.gentle_lift import HANDWARD, UNDER, WAIST, WAY, _lifted_at
from tests.envs.conftest import environment, play, start


def _begun(task: str, preferences: list[str]) -> tuple[Any, Any, TouchReadings]:
    """Return the task, the state of one simulation for each preference, readings of the start."""
    env: Any = environment(task, "native")
    n = len(preferences)
    keys = jax.random.split(jax.random.key(1), n)
    state = env.reset(keys, disability_params(["d1"] * n, preferences))
    values = env._physics.forward(state.physics, env._joint_range(state.params))
    return env._task, state.task, env._sensors.read(values)


def test_an_arm_starts_somewhere_on_its_way_and_slides_off_when_nobody_holds_it() -> None:
    state, model = (
        start("gentle_lift", "native", ["d1"] * 64),
        environment("gentle_lift", "native").model,
    )
    columns = [model.joint(name).qposadr[0] for name in HUMAN_ACTUATORS]
    arms = np.asarray(state.physics.qpos)[:, columns]
    gaps = np.linalg.norm(arms[:, None] - _between(np.array(WAY))[None], axis=-1).min(axis=1)
    assert gaps.max() < 0.08  # rad: the noise of a start
    assert np.ptp(arms[:, 0]) > 1.2 and np.ptp(arms[:, 2]) > 0.7
    still = [{"robot": jnp.zeros((64, 7)), "human": jnp.zeros((64, 3))}] * 100
    states = play("gentle_lift", "native", state, still)
    assert float(states[0].measures.force.max()) == 0.0
    assert float(states[-1].task.left.min()) > 0.15
    assert not np.asarray(states[-1].measures.success).any()


def _between(corners: np.ndarray) -> np.ndarray:
    places = np.linspace(0, len(corners) - 1, 500)
    return np.stack([np.interp(places, range(len(corners)), each) for each in corners.T], axis=1)


def test_the_hook_is_drawn_below_the_forearm_on_the_hands_side() -> None:
    _, _, readings = _begun("gentle_lift", ["p1"] * 4)
    section, upper = readings.arm_position[:, 1], readings.arm_position[:, 0]
    offset = np.array(_lifted_at(section, readings) - section)
    offset[:, 2] += UNDER
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), HANDWARD, rtol=1e-4)
    assert ((offset * np.asarray(section - upper)).sum(axis=1) > 0.0).all()  # not to the elbow


def test_rest_pays_most_with_the_hook_at_the_liked_distance_and_nothing_with_a_touch() -> None:
    names = list(PREFERENCES)
    task, state, readings = _begun("gentle_lift", names)
    waist = jnp.broadcast_to(jnp.asarray(WAIST), (len(names), 3))

    def paid(distance: float, force: float = 0.0) -> dict[str, np.ndarray]:
        there = dataclasses.replace(
            readings,
            arm_position=readings.arm_position.at[:, 1].set(waist),
            tool_position=waist.at[:, 2].add(distance),
            force=jnp.full(len(names), force),
        )
        after, _, _, _ = task.transition(state, there)
        return {k: np.asarray(v) for k, v in task.transition(after, there)[2].items()}

    pays = {distance: paid(distance)["rest"] for distance in (0.1, 0.25, 0.6)}
    for row, one in enumerate(PREFERENCES.values()):
        assert pays[one.distance][row] == pytest.approx(1.0, abs=1e-4)
        others = [pays[d][row] for d in pays if d != one.distance]
        assert max(others) < 0.7 and min(others) > 0.2
    assert not paid(0.1, force=1.0)["rest"].any()
    assert all(not value.any() for name, value in paid(0.25).items() if name in ("lift", "swing"))


def test_a_point_on_the_arms_far_side_is_farther_than_the_way_through_the_arm() -> None:
    task, _, _ = _begun("gentle_bath", ["p5"])
    tool = jnp.asarray(0.1 * task._outward[:1] + task._offset[:1])  # over the first point
    for sign, turned in ((1.0, 0.0), (-1.0, 1.0)):
        both = jnp.broadcast_to(sign * tool[:, None], (1, 2, 3))
        assert float(task._turned_away(both)[0, 0]) == pytest.approx(turned, abs=1e-5)
    along = jnp.broadcast_to(tool[:, None].at[..., 2].add(0.2), (1, 2, 3))
    assert float(task._turned_away(along)[0, 0]) == pytest.approx(0.0, abs=1e-5)
