"""Backends earn the same: returns of a published team over 64 episodes, paired by start, on MuJoCo
and on MJX.

The team touches and presses, or lifts, for a third of the time or more, which is where float32 and
float64 part: single episodes differ, and what must not differ is their mean, because policies
trained on one backend are judged on another.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs import disability_params
from assistax_envs.versions import PAPER_TASKS
from tests.envs.teams import team

TEAMS = {
    "scratch": "scratch/ippo-d9-s0-v1",
    "bed_bath": "bed_bath/ippo-d1-s0-v1",
    "arm_assist": "arm_assist/ippo-d1-s1-v1",
}
EPISODES = 64
STEPS = {
    "scratch": 200,
    "bed_bath": 200,
    "arm_assist": 50,
}  # an arm is lifted in half a second, and then it lies
SURE = 3.0  # standard errors on each side: an interval of 99.6% for 63 degrees of freedom
SMALL = 0.005  # of the mean return: a difference that is sure, but does not matter


@functools.cache
def returns(
    task: str, backend: str, gravity: float = 1.0, setting: str | None = None
) -> tuple[np.ndarray, float]:
    """Return what each episode earned [64], and the share of steps with the tool on the arm or the
    goal reached.
    """
    env = assistax_envs.make(task, backend)
    # Gravity is no option of an environment.
    env._physics.model.opt.gravity[:] *= gravity
    act = team(TEAMS[task], EPISODES)
    params = disability_params([setting or TEAMS[task].split("-")[1]] * EPISODES)
    start = env.reset(jax.random.split(jax.random.key(5), EPISODES), params)

    def step(state, time):
        state = env.step(state, act(state, time))
        return state, (state.reward, (state.measures.force > 0) | state.measures.success)

    last, (reward, busy) = jax.jit(
        lambda state: jax.lax.scan(step, state, jnp.arange(STEPS[task]))
    )(start)
    assert not bool(last.nonfinite.any())
    return np.asarray(reward, np.float64).sum(axis=0), float(np.asarray(busy).mean())


def differ(ours: np.ndarray, theirs: np.ndarray) -> bool:
    """Return whether the mean of the paired differences is surely not 0, and large enough to
    matter.
    """
    difference = ours - theirs
    error = difference.std(ddof=1) / np.sqrt(difference.size)
    return bool(
        abs(difference.mean()) > SURE * error
        and abs(difference.mean()) > SMALL * abs(theirs.mean())
    )


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["fused", "mjx"])
@pytest.mark.parametrize("task", PAPER_TASKS)
def test_mean_returns_agree(task: str, backend: str) -> None:
    native, busy = returns(task, "native")
    other, also_busy = returns(task, backend)
    assert min(busy, also_busy) > 0.3
    assert not differ(other, native)
    # A wide interval hides nothing either.
    assert abs(other.mean() - native.mean()) < SMALL * abs(native.mean())


@pytest.mark.slow
@pytest.mark.parametrize("task", PAPER_TASKS)
def test_other_physics_would_be_noticed(task: str) -> None:
    """Planted: gravity 20% stronger on one side."""
    assert differ(returns(task, "native", gravity=1.2)[0], returns(task, "native")[0])


@pytest.mark.slow
def test_another_disability_would_be_noticed() -> None:
    """Planted: one side plays without the human's impairment."""
    assert differ(returns("scratch", "native", setting="d1")[0], returns("scratch", "native")[0])
