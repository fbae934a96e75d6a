"""Scripts of the gentle tasks and their numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.models import build_model
from assistax_envs.tasks.chain import SCRIPTS, Chain, script_of
from assistax_envs.versions import CARE_TASKS

RANGES = {task: script.ranges for task, script in SCRIPTS.items() if script.ranges}
SKIN = ("gentle_scratch", "gentle_bath")
NORMAL = {
    "gentle_scratch": slice(37, 40),
    "gentle_bath": slice(33, 36),
    "gentle_brushing": slice(42, 45),
}
# In 10 N, of a brush in 5 N.
FORCE = {
    "gentle_scratch": 43,
    "gentle_bath": 37,
    "gentle_lift": 38,
    "gentle_feeding": 45,
    "gentle_brushing": 68,
}


def _seen(task: str, count: int = 400, seed: int = 5) -> jnp.ndarray:
    """Return observations [N, 72] with the tool near its target, at all forces."""
    rng = np.random.default_rng(seed)
    obs = rng.normal(0.0, 0.4, (count, 72))
    obs[:, 30:34] = rng.normal(0.0, 0.06, (count, 4))
    obs[:, 21:24] = rng.normal(0.0, 10.0, (count, 3))
    obs[:, 34:37] = rng.normal(0.0, 0.1, (count, 3))
    if task in CARE_TASKS:  # near the mouth, and near the place that is brushed
        obs[:, 14:17] = obs[:, 24:27] + rng.normal(0.0, 0.03, (count, 3))
    if task == "gentle_feeding":
        obs[:, 36] = rng.uniform(size=count)
        obs[:, 37:42] = np.eye(5)[rng.integers(0, 5, count)]
    if task == "gentle_brushing":
        obs[:, 39:42] *= rng.choice([0.05, 0.5], (count, 1))
        obs[:, 63] = rng.integers(0, 2, count)
    if task in NORMAL:
        normal = rng.normal(size=(count, 3))
        obs[:, NORMAL[task]] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    elif task not in CARE_TASKS:
        obs[:, 37] = np.abs(rng.normal(0.0, 0.1, count))  # m to the waist
    # A third each: hard, light, or no touch.
    obs[:, FORCE[task]] = rng.uniform(0.0, 7.0, count) * rng.choice([1.0, 0.015, 0.0], count)
    turn = rng.normal(size=(count, 4))
    obs[:, 17:21] = turn / np.linalg.norm(turn, axis=1, keepdims=True)
    return jnp.asarray(obs, jnp.float32)


@pytest.mark.slow_for("bath", "brushing", "lift")
@pytest.mark.parametrize("task", RANGES)
def test_script_numbers_matter_and_lie_in_range(task: str) -> None:
    model, obs = build_model(task), _seen(task)
    own = SCRIPTS[task].numbers
    assert set(own) == set(RANGES[task])
    # Somewhere in the ranges, where no number hides another.
    middle = {name: 0.5 * (low + high) for name, (low, high) in RANGES[task].items()}
    usual = script_of(task, model, middle)(obs)
    for name, (low, high) in RANGES[task].items():
        assert low < high and low <= own[name] <= high, name
        ends = [script_of(task, model, middle | {name: end})(obs) for end in (low, high)]
        moved = [float(jnp.abs(end - usual).max()) for end in ends]
        assert max(moved) > 1e-4, f"{name} changes nothing"
    np.testing.assert_array_equal(script_of(task, model)(obs), script_of(task, model, own)(obs))


@pytest.mark.parametrize("task", RANGES)
def test_search_tries_numbers_side_by_side(task: str) -> None:
    model, obs = build_model(task), _seen(task, 16)
    ends = {name: jnp.array(between, jnp.float32) for name, between in RANGES[task].items()}
    both = jax.vmap(lambda numbers: script_of(task, model, numbers)(obs))(ends)
    for place in range(2):
        one = {name: float(values[place]) for name, values in ends.items()}
        np.testing.assert_allclose(both[place], script_of(task, model, one)(obs), atol=1e-4)


@pytest.mark.parametrize("task", SKIN)
def test_hard_pressing_tool_only_lifts(task: str) -> None:
    """Along the skin's normal, whatever else it was about to do."""
    model = build_model(task)
    numbers = {"stop": 10.0, "lift": 0.1, "turn": 0.0, "damping": 1e-5}
    obs = _seen(task).at[:, FORCE[task]].set(2.0)
    # A posture in which the arm moves the tool in all directions.
    angles = jnp.array([0.0, 0.4, 0.0, -1.5, 0.0, 1.8, 0.0])
    obs = obs.at[:, :7].set(angles).at[:, 14:17].set(_tool(model, angles))
    action = script_of(task, model, numbers)(obs)
    normal = obs[:, NORMAL[task]]
    lifted = Chain(model).drive(obs, 0.1 * normal, normal, turn=0.0, damping=1e-5)
    np.testing.assert_allclose(action, lifted, atol=1e-5)
    lighter = script_of(task, model, numbers | {"stop": 50.0})(obs)
    assert float(jnp.abs(lighter - lifted).max()) > 1e-2


def _tool(model, angles) -> np.ndarray:
    import mujoco

    data = mujoco.MjData(model)
    for i, angle in enumerate(angles):
        data.qpos[model.joint(f"robot_joint{i + 1}").qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return np.array(data.site_xpos[model.site("robot_end_effector").id], np.float32)
