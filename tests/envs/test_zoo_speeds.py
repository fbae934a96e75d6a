"""Trained robots keep to the datasheet: what full torques on all joints could exceed, no published
robot does.

docs/environments.md has the figures of four teams a task; here is the fastest team of scratch, over
two episodes.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from assistax_envs.tasks.base import ROBOT_JOINTS
from tests.envs.conftest import environment
from tests.envs.teams import Players, random_players, team
from tests.envs.test_believable import SPEED_LIMITS

EPISODES, STEPS = 2, 1000


def fastest(act: Players) -> float:
    """Return the largest joint speed of the robot, as a share of its limit."""
    env = environment("scratch", "native")
    joints = np.array([env.model.joint(name).dofadr[0] for name in ROBOT_JOINTS])
    start = env.reset(
        jax.random.split(jax.random.key(3), EPISODES), disability_params(["d1"] * EPISODES)
    )

    def step(state, time):
        state = env.step(state, act(state, time))
        return state, jnp.abs(state.physics.qvel[:, joints])

    _, speeds = jax.jit(lambda state: jax.lax.scan(step, state, jnp.arange(STEPS)))(start)
    return float((np.asarray(speeds) / SPEED_LIMITS).max())


@pytest.mark.slow
def test_trained_robot_stays_within_the_panda_speed() -> None:
    assert 0.3 < fastest(team("scratch/ippo-d1-s3-v1", EPISODES)) <= 1.0


@pytest.mark.slow
def test_torques_that_switch_at_random_do_not() -> None:
    """Planted: full torques, drawn anew every half second, are the play that the limit is exceeded
    in.
    """
    assert fastest(random_players(EPISODES, hold=25, seed=0)) > 1.0
