"""The Warp backend without a GPU: Warp's kernels also compile for the CPU, slowly, and do the same
there.

Runs where the extra `warp` is installed.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.physics import PhysicsState
from assistax_envs.physics import mjx as backend
from assistax_envs.versions import PAPER_TASKS
from tests.envs.conftest import environment, start

warp = pytest.importorskip("warp")

pytestmark = pytest.mark.slow
SIZE = 4


@pytest.fixture(autouse=True)
def without_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    # The check asks for a GPU: these kernels run on a processor too.
    monkeypatch.setattr(backend, "_check_warp", lambda: None)


def advance(physics, task: str, steps: int = 12) -> tuple[PhysicsState, jax.Array]:
    """Return the state and the sensor values after constant torques, the arm's included."""
    env = environment(task, "native")
    state = start(task, "native", ["d1", "d9", "d3", "d7"])
    control = jnp.asarray(
        np.random.default_rng(0).uniform(-0.7, 0.7, (SIZE, env.model.nu)), jnp.float32
    )
    # The range of joints is an input of the engine, which no state keeps.
    limits = env._joint_range(state.params)
    # A new function each time: JAX may keep what it traced of a method, whose model changes here.
    step = jax.jit(lambda *arguments: physics.step(*arguments))
    physics_state, values = step(state.physics, control, limits)
    for _ in range(steps - 1):
        physics_state, values = step(physics_state, control, limits)
    return physics_state, values


@pytest.mark.parametrize("task", PAPER_TASKS)
def test_substeps_without_sensors_change_no_bit(task: str) -> None:
    physics = backend.MjxPhysics(environment(task, "native").model, "warp")
    lean = advance(physics, task)
    # The model without sensors is an inner shortcut, which the test takes away.
    blind, physics._blind_model = physics._blind_model, None
    jax.tree.map(np.testing.assert_array_equal, lean, advance(physics, task))
    assert blind is not None
    # Planted: a shortcut that differs in more than its sensors.
    physics._blind_model = blind.tree_replace({"opt.timestep": 2 * blind.opt.timestep})
    assert not np.array_equal(advance(physics, task)[0].qpos, lean[0].qpos)


@pytest.mark.parametrize("task", PAPER_TASKS)
def test_it_agrees_with_mujoco(task: str) -> None:
    ours, values = advance(backend.MjxPhysics(environment(task, "native").model, "warp"), task)
    # The engine alone, step by step.
    theirs, expected = advance(environment(task, "native")._physics, task)
    np.testing.assert_allclose(ours.qpos, theirs.qpos, atol=3e-2)
    assert float(np.abs(ours.qpos - theirs.qpos).mean()) < 1e-3
    # Values of another moment would not pass: one step apart they differ by 4e-3 or more.
    assert float(np.abs(values - expected).mean()) < 1e-3
