import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from population.config import Member
from population.hyperparameters import SACConfig, preset
from population.networks import policy
from population.trainers import replay_buffer
from population.trainers.sac import SAC
from population.trainers.sac_losses import soft_target
from tests.population import test_ppo
from tests.population.toy_env import ToyEnv, constant, match, together

SMALL: dict[str, Any] = {"num_envs": 8, "rollout_steps": 5, "hidden": (16, 16), "gamma": 0.9}
SMALL |= {"replay_size": 2000, "exploration_steps": 200, "batch_size": 32, "updates": 8}
SMALL |= {"policy_delay": 2, "policy_lr": 3e-3, "q_lr": 1e-2, "alpha_lr": 1e-2, "tau": 0.05}
run = partial(test_ppo.run, kind=SAC)


def values(sac, state, role, action):
    """Return the critics' values of the first member's observations and an action [N, A]."""
    member = jax.tree.map(lambda leaf: leaf[0], state.members)
    # What critics say, which training never returns.
    return sac._values(
        role, member.learners[role].networks["critic"], member, state.simulations.env.obs, action
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "terminates",
    [False, pytest.param(True, marks=pytest.mark.slow)],
    ids=["time-limit", "planted-termination"],
)
def test_constant_reward_value_bootstraps_at_time_limit(terminates):
    """The value is 1 / (1 - gamma) = 10 at a time limit; the planted termination lowers it."""
    config = SACConfig(**SMALL, autotune=False, initial_alpha=1e-6)
    sac, state, metrics = run(ToyEnv(constant, terminates=terminates), config, updates=150)
    q = values(sac, state, "robot", {"robot": jnp.zeros((8, 1))})
    if terminates:
        assert q.mean() < 8.5
    else:
        np.testing.assert_allclose(q, 10.0, atol=0.7)
    assert not np.asarray(metrics["q_loss_robot"])[:4].any()  # exploring: nothing is learnt yet


@pytest.mark.slow
@pytest.mark.parametrize("planted", [False, True], ids=["squashed", "planted-unsquashed"])
def test_policy_without_reward_becomes_uniform(planted, monkeypatch):
    """The uniform density has the largest entropy in [-1, 1]: mean |a| is 1/2."""
    if planted:
        # The planted defect: the squash's slope left out.
        monkeypatch.setattr(policy, "_log_slope", jnp.zeros_like)
    config = SACConfig(**SMALL, autotune=False, initial_alpha=0.5, critic="local")
    sac, state, _ = run(ToyEnv(constant), config, updates=150)
    member = jax.tree.map(lambda leaf: leaf[0], state.members)
    keys = jax.random.split(jax.random.key(3), 500)
    obs = state.simulations.env.obs
    # Actions as the trainer draws them, from a state of training.
    action, _ = jax.vmap(lambda key: sac._act(member.learners, member, obs, key))(keys)
    size = float(jnp.abs(action["human"]).mean())
    assert (abs(size - 0.5) < 0.06) != planted


@pytest.mark.slow
def test_the_temperature_drives_the_entropy_to_its_target():
    config = SACConfig(**{**SMALL, "alpha_lr": 3e-2}, target_entropy_scale=0.5)
    _, _, metrics = run(ToyEnv(match), config, updates=250)
    for role, size in (("robot", 1), ("human", 2)):
        assert np.asarray(metrics[f"entropy_{role}"])[-50:].mean() == pytest.approx(
            -0.5 * size, abs=0.25
        )


@pytest.mark.parametrize(
    ("algorithm", "reward"),
    [("isac", match), ("masac", together)],
    ids=["isac-match", "masac-together"],
)
@pytest.mark.slow
def test_both_roles_learn_from_their_observations(algorithm, reward):
    env = ToyEnv(reward)
    sac, state, _ = run(
        env, preset(algorithm, **{**SMALL, "target_entropy_scale": 2.0}), updates=250
    )
    (figures,) = test_ppo.deterministic_return(env, sac, state)
    assert figures["mean"] > 0.9 * env.episode_length


def test_soft_targets_are_those_of_the_formula():
    rng = np.random.default_rng(0)
    reward, log_prob, q = rng.normal(size=6), rng.normal(size=6), rng.normal(size=(2, 6))
    terminated = np.array([False, True, False, False, True, False])
    expected = []
    for b in range(6):
        value = min(q[0, b], q[1, b]) - 0.3 * log_prob[b]
        expected.append(reward[b] + (0.0 if terminated[b] else 0.9 * value))
    target = soft_target(*(jnp.asarray(x) for x in (reward, terminated, q, log_prob)), 0.3, 0.9)
    np.testing.assert_allclose(target, expected, rtol=1e-5)


class Misplaced(SAC):
    """A planted defect: a time limit's successor is the next episode's first observation."""

    def collect(self, state, partners=()):
        state, batch, keys = super().collect(state, partners)
        return state, dataclasses.replace(batch, truncated=jnp.zeros_like(batch.truncated)), keys


@pytest.mark.parametrize("kind", [SAC, Misplaced])
@pytest.mark.slow
def test_replayed_successor_is_the_reached_observation(kind):
    """The toy's noise is the sine of the step, and the ring is written over twice."""
    env = ToyEnv(match)
    config = SACConfig(**{**SMALL, "replay_size": 160, "exploration_steps": 10**6})
    _, state, _ = run(env, config, updates=9, kind=kind)
    drawn = replay_buffer.draw(state.replay, jax.random.split(jax.random.key(1), 1), (2, 1000))
    assert drawn.obs["human"].shape == (1, 2, 1000, 3)
    here, there = (np.asarray(x["robot"])[..., 1].reshape(-1) for x in (drawn.obs, drawn.next_obs))
    known = np.sin(np.arange(env.episode_length + 1))
    step = np.abs(here[:, None] - known[None, :-1]).argmin(1)
    assert set(step) == set(range(env.episode_length))
    right = np.allclose(there, known[step + 1], atol=1e-5)
    assert right == (kind is SAC)
    assert np.abs(drawn.action["robot"]).max() <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["cpu", "gpu"])
def test_member_ignores_other_members(platform, monkeypatch):
    """Taken in turn, as on a CPU, or vectorised, as on an accelerator."""
    config = SACConfig(**SMALL)
    _, alone, _ = run(
        ToyEnv(match), dataclasses.replace(config, q_lr=3e-3), (Member(4, "d9"),), updates=7
    )
    monkeypatch.setattr(jax, "default_backend", lambda: platform)
    members = (Member(0, "d1"), Member(4, "d9", {"q_lr": 3e-3}))
    _, beside, _ = run(ToyEnv(match), config, members, updates=7)
    networks = [test_ppo.networks(state) for state in (beside, alone)]
    assert_close = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5)
    jax.tree.map(lambda many, alone: assert_close(many[1:2], alone), *networks)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"torso": "gru"}, "SAC is feed-forward only"),
        ({"updates": 6, "policy_delay": 4}, "choose updates as a multiple of it"),
        ({"replay_size": 10}, "a rollout has 512 transitions"),
        ({"tau": 2.0}, "tau is 2.0; it must be less than or equal to 1"),
        ({"shared": True}, "unknown hyperparameter shared of isac"),
    ],
)
def test_bad_hyperparameters_are_named(changes, message):
    with pytest.raises(ValueError, match=message):
        preset("isac", **changes)
