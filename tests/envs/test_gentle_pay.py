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
from assistax_envs.tasks.care import WHATEVER
from assistax_envs.tasks.gentle_base import TouchReadings

# The formula by itself, at values that play seldom reaches.
from assistax_envs.tasks.gentle_lift.task import HANDWARD, THERE, UNDER, WAY, _lifted_at
from tests.envs.conftest import environment, play, start


def _begun(task: str, preferences: list[str]) -> tuple[Any, Any, TouchReadings]:
    """Return the task, the state of one simulation for each preference, readings of the start."""
    env: Any = environment(task, "native")
    n = len(preferences)
    keys = jax.random.split(jax.random.key(1), n)
    state = env.reset(keys, disability_params(["d1"] * n, preferences))
    # Readings that tests alter before the task pays for them: an environment returns neither.
    values = env._physics.forward(state.physics, env._joint_range(state.params))
    return env._task, state.task, env._sensors.read(values)


@pytest.mark.slow
def test_arm_starts_on_its_way_and_slides_off() -> None:
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
    assert float(states[-1].task.left.min()) > THERE
    assert not np.asarray(states[-1].measures.success).any()


def _between(corners: np.ndarray) -> np.ndarray:
    places = np.linspace(0, len(corners) - 1, 500)
    return np.stack(
        [np.interp(places, range(len(corners)), column) for column in corners.T], axis=1
    )


@pytest.mark.slow
def test_hook_lifts_below_the_forearm_near_the_hand() -> None:
    _, _, readings = _begun("gentle_lift", ["p1"] * 4)
    section, upper = readings.arm_position[:, 1], readings.arm_position[:, 0]
    offset = np.array(_lifted_at(section, readings) - section)
    offset[:, 2] += UNDER
    np.testing.assert_allclose(np.linalg.norm(offset, axis=1), HANDWARD, rtol=1e-4)
    assert ((offset * np.asarray(section - upper)).sum(axis=1) > 0.0).all()  # not to the elbow


def _rest(arm: jax.Array, distance: float, force: float = 0.0) -> dict[str, np.ndarray]:
    """Return the terms of arms at rest at `arm` [9, 3] under p1..p9, the hook above them."""
    names = list(PREFERENCES)
    task, state, readings = _begun("gentle_lift", names)
    there = dataclasses.replace(
        readings,
        arm_position=readings.arm_position.at[:, 1].set(arm),
        tool_position=arm.at[:, 2].add(distance),
        force=jnp.full(len(names), force),
    )
    after, _, _, _ = task.transition(state, there)
    return {name: np.asarray(value) for name, value in task.transition(after, there)[2].items()}


@pytest.mark.slow
def test_rest_reward_peaks_at_preferred_distance() -> None:
    _, state, _ = _begun("gentle_lift", list(PREFERENCES))
    pays = {distance: _rest(state.waist, distance)["rest"] for distance in (0.1, 0.25, 0.6)}
    for row, preference in enumerate(PREFERENCES.values()):
        assert pays[preference.distance][row] == pytest.approx(1.0, abs=1e-4)
        others = [pays[d][row] for d in pays if d != preference.distance]
        # What nobody likes earns near nothing: these are 2.4 times too far or too near, or more.
        assert max(others) < 0.1 and min(others) >= WHATEVER
    assert not _rest(state.waist, 0.1, force=1.0)["rest"].any()
    still = _rest(state.waist, 0.25)
    assert all(not value.any() for name, value in still.items() if name in ("lift", "swing"))


@pytest.mark.slow
def test_rest_pays_at_the_hidden_preferred_place_alone() -> None:
    names = list(PREFERENCES)
    _, state, _ = _begun("gentle_lift", names)
    for name in names:
        place = jnp.broadcast_to(state.waist[names.index(name)], (len(names), 3))
        pays = _rest(place, 0.25)
        same = np.array(
            [preference.place == PREFERENCES[name].place for preference in PREFERENCES.values()]
        )
        assert (pays["rest"][same] >= WHATEVER).all() and not pays["rest"][~same].any()
        assert (pays["there"][same] > 0.99).all() and (pays["there"][~same] < 0.3).all()
    env = environment("gentle_lift", "native")
    keys = jnp.broadcast_to(jax.random.key(1), (len(names),))
    obs = env.reset(keys, disability_params(["d1"] * len(names), names)).obs
    np.testing.assert_array_equal(
        obs["robot"], jnp.broadcast_to(obs["robot"][:1], obs["robot"].shape)
    )
    assert len(np.unique(np.asarray(obs["human"])[:, -2:].round(3), axis=0)) == 9


@pytest.mark.slow
def test_point_on_the_far_side_is_farther() -> None:
    task, _, _ = _begun("gentle_bath", ["p5"])
    tool = jnp.asarray(0.1 * task._outward[:1] + task._offset[:1])  # over the first point
    for sign, turned in ((1.0, 0.0), (-1.0, 1.0)):
        both = jnp.broadcast_to(sign * tool[:, None], (1, 2, 3))
        # The turn by itself: the pay adds it to a distance.
        assert float(task._turned_away(both)[0, 0]) == pytest.approx(turned, abs=1e-5)
    along = jnp.broadcast_to(tool[:, None].at[..., 2].add(0.2), (1, 2, 3))
    assert float(task._turned_away(along)[0, 0]) == pytest.approx(0.0, abs=1e-5)
