"""Golden trajectories, to the bit: they change only with `FUSED_VERSION` or a task's version.

To renew them after either was raised: `python -m tests.envs.fused.test_golden`.
"""

import hashlib
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import TASKS
from assistax_envs.physics import PhysicsState, make_physics
from assistax_envs.versions import FUSED_VERSION
from tests.envs.fused.scenes import scene, team_states

FILE = Path(__file__).with_name("golden.json")
SIMULATIONS, STEPS = 37, 25  # an odd number: the last vector is not full


def trajectory(task: str) -> str:
    """Return the sha256 of all angles, velocities and sensor values on the way."""
    model, (states, ranges) = scene(task), team_states(task)
    physics = make_physics(model, "fused")
    rng = np.random.default_rng(17)
    controls = rng.uniform(-1, 1, (STEPS, SIMULATIONS, model.nu)).astype(np.float32)
    joint_range = jnp.asarray(ranges[:SIMULATIONS], jnp.float32)

    @jax.jit
    def play(state: PhysicsState) -> tuple[jax.Array, ...]:
        def step(state, control):
            state, sensors = physics.step(state, control, joint_range)
            # What the largest forces of substeps add comes after these.
            return state, (state.qpos, state.qvel, sensors[:, : model.nsensordata])

        return jax.lax.scan(step, state, controls)[1]

    qpos, qvel = (jnp.asarray(x[:SIMULATIONS], jnp.float32) for x in (states.qpos, states.qvel))
    whole = hashlib.sha256()
    for values in play(PhysicsState(qpos, qvel, jnp.zeros_like(qvel))):
        assert np.isfinite(values).all()
        whole.update(np.asarray(values, "<f4").tobytes())
    return whole.hexdigest()


@pytest.mark.parametrize("task", TASKS)
def test_not_a_bit_changes_without_a_new_version(task: str) -> None:
    golden = json.loads(FILE.read_text())
    assert golden["version"] == FUSED_VERSION, (
        "the version was raised: renew the golden trajectories"
    )
    assert trajectory(task) == golden[task]


if __name__ == "__main__":
    digests = {task: trajectory(task) for task in TASKS}
    FILE.write_text(json.dumps({"version": FUSED_VERSION, **digests}, indent=2) + "\n")
