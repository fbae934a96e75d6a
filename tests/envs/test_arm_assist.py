"""Arm assist: the rewards of Table 5, an idle robot that fails and a trained one that lifts."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from assistax_envs import disability_params
from assistax_envs.tasks.arm_assist.task import ARRIVED, LARGEST_NORM, ArmAssist, arm_assist_terms
from tests.envs.conftest import compiled, environment, start
from tests.envs.teams import Players, team

SIZE = 16  # simulations of an episode
WEIGHTS = {"reach_target": 1.0, "reach_waist": 10.0, "rotation": 0.1}


@pytest.mark.parametrize(("rotation", "norm"), [("aligned", 0.0), ("printed", LARGEST_NORM)])
def test_perfect_episode_earns_the_paper_bound(rotation: str, norm: float) -> None:
    terms = arm_assist_terms(jnp.zeros(1), jnp.zeros(1), jnp.full(1, norm), rotation)
    assert (
        round(1000 * sum(WEIGHTS[name] * float(term[0]) for name, term in terms.items())) == 11346
    )


def test_rotation_terms_follow_misalignment_in_opposite_directions() -> None:
    norms = jnp.array([0.0, 1.0, 2.0])
    zero = jnp.zeros(3)
    assert np.all(np.diff(arm_assist_terms(zero, zero, norms, "printed")["rotation"]) > 0)
    assert np.all(np.diff(arm_assist_terms(zero, zero, norms, "aligned")["rotation"]) < 0)


def test_hook_target_orientation_is_near_the_start() -> None:
    env = environment("arm_assist", "native")
    # The orientation by itself: observations hold its difference from the tool's.
    hook = ArmAssist(env.model)._hook
    np.testing.assert_allclose(hook.T @ hook, np.eye(3), atol=1e-5)
    assert np.linalg.det(hook) == pytest.approx(1.0, abs=1e-5)
    state = start("arm_assist", "native", ["d1"] * 8)
    turn = np.asarray(state.obs["robot"][:, 34:43])
    assert np.all(np.linalg.norm(turn, axis=-1) < 2.0 * np.sqrt(2.0))


def test_hook_starts_below_the_forearm() -> None:
    """From above, robots get stuck on top of the arm: `docs/environments.md` has how many."""
    model = environment("arm_assist", "native").model
    data = mujoco.MjData(model)
    draw = jax.jit(ArmAssist(model).pose.draw)
    for key in jax.random.split(jax.random.key(0), 100):
        data.qpos[:] = draw(key)
        mujoco.mj_forward(model, data)
        away = data.site("robot_end_effector").xpos - data.site("human_right_lower_arm").xpos
        assert away[2] < -0.02 and 0.1 < np.linalg.norm(away) < 0.35
        touching = {model.geom(geom).name for contact in data.contact for geom in contact.geom}
        assert not any(name.startswith("robot_") for name in touching)


def _distances(act: Players) -> np.ndarray:
    """Return the distance [T, N] from forearm to waist target over an episode."""
    env = environment("arm_assist", "native")
    state = compiled("arm_assist", "native")[0](
        jax.random.split(jax.random.key(3), SIZE), disability_params(["d1"] * SIZE)
    )

    def body(state, time):
        state = env.step(state, act(state, time))
        return state, state.obs["global"][:, -1]

    return np.asarray(jax.jit(lambda state: jax.lax.scan(body, state, jnp.arange(1000))[1])(state))


@pytest.mark.slow
def test_human_cannot_lift_its_arm_alone() -> None:
    signs = jnp.array([[a, b, c] for a in (-1.0, 1.0) for b in (-1.0, 1.0) for c in (-1.0, 1.0)])

    def push(state, time):
        still = jnp.zeros((SIZE, 7))
        hold = jnp.broadcast_to(signs, (8, 3))
        phase = jax.random.fold_in(jax.random.key(5), time // 25)
        return {
            "robot": still,
            "human": jnp.concatenate([hold, jax.random.rademacher(phase, (8, 3), jnp.float32)]),
        }

    assert _distances(push).min() > 2.0 * ARRIVED


@pytest.mark.slow
def test_trained_robot_lifts_the_arm() -> None:
    assert (_distances(team("arm_assist/ippo-d1-s2-v1", SIZE))[-1] < 1.5 * ARRIVED).mean() > 0.8
