"""States of trained teams, one in 100,000, in which rounding decides which rows act."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs.physics import PhysicsState, make_physics
from tests.envs.fused.scenes import States, oracle, scene

FILE = Path(__file__).with_name("stubborn_states.npz")


@pytest.mark.parametrize("task", ["scratch", "bed_bath"])
def test_forces_settle_where_rounding_decides_which_rows_act(task: str) -> None:
    with np.load(FILE) as file:
        qpos, qvel, ctrl, ranges = (file[f"{task}_{k}"] for k in ("qpos", "qvel", "ctrl", "ranges"))
    start = PhysicsState(jnp.asarray(qpos), jnp.asarray(qvel), jnp.zeros(qvel.shape, jnp.float32))
    after, _ = make_physics(scene(task), "fused").step(
        start, jnp.asarray(ctrl), jnp.asarray(ranges, jnp.float32)
    )
    _, want, _ = oracle(scene(task), States(qpos, qvel, ctrl), 4, ranges)
    error = np.abs(np.asarray(after.qvel) - want).max(axis=1)  # rad/s
    assert error.max() < 5e-3
    assert np.median(error) < 3e-4
