import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.play.self_play import self_play
from tests.population.toy_env import ToyEnv, constant, match

POLICIES = {
    "robot": Policy(PolicySpec("robot", 2, 1, hidden=(8,))),
    "human": Policy(PolicySpec("human", 3, 2, hidden=(8,))),
}
TEAMS = 3


KEYS = jax.random.split(jax.random.key(0), TEAMS)


def params_of_teams():
    return {role: jax.vmap(policy.init)(KEYS) for role, policy in POLICIES.items()}


def play(reward, teams=slice(None), **changes):
    """Return the figures of some of the teams."""
    params = jax.tree.map(lambda leaf: leaf[teams], params_of_teams())
    keys = KEYS[teams]
    humans = disability_params(["d1"] * len(keys))
    return self_play(ToyEnv(reward, **changes), POLICIES, params, humans, keys, 16)


@pytest.mark.parametrize("terminates", [False, True])
def test_constant_reward_returns_the_episode_length(terminates):
    figures = {"mean": 20.0, "iqm": 20.0, "mean_ci": [20.0, 20.0], "n": 16, "success": 1.0}
    assert play(constant, terminates=terminates) == [figures] * TEAMS


def test_figures_repeat_and_teams_play_their_own_parameters():
    results = play(match)
    for figures in results:
        assert figures["mean_ci"][0] <= figures["mean"] <= figures["mean_ci"][1]
    assert results == play(match)
    assert len({figures["mean"] for figures in results}) == TEAMS
    [alone] = play(match, teams=slice(1, 2))
    np.testing.assert_allclose(alone["mean"], results[1]["mean"], rtol=1e-5)


def test_figures_are_those_of_a_plain_loop():
    """Oracle: one team, step by step, one policy at a time."""
    env, team, params = ToyEnv(match), 2, params_of_teams()
    state = env.reset(jax.random.split(KEYS[team], 16), disability_params(["d1"] * 16))
    carry, returns = dict.fromkeys(POLICIES, ()), np.zeros(16)
    for time in range(env.episode_length):
        action = {}
        for role, policy in POLICIES.items():
            own = jax.tree.map(lambda leaf: leaf[team], params[role])
            first = jnp.full(16, time == 0)
            carry[role], action[role] = policy.act(own, carry[role], state.obs[role], first)
        state = env.step(state, action)
        returns += np.asarray(state.reward)
    np.testing.assert_allclose(play(match)[team]["mean"], returns.mean(), rtol=1e-6)
