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


def play(reward, episodes=16, **changes):
    keys = jax.random.split(jax.random.key(0), TEAMS)
    params = {role: jax.vmap(policy.init)(keys) for role, policy in POLICIES.items()}
    return self_play(
        ToyEnv(reward, **changes),
        POLICIES,
        params,
        disability_params(["d1"] * TEAMS),
        keys,
        episodes,
    )


@pytest.mark.parametrize("terminates", [False, True])
def test_constant_reward_returns_the_episode_length(terminates):
    figures = {"mean": 20.0, "iqm": 20.0, "mean_ci": [20.0, 20.0], "n": 16, "success": 1.0}
    assert play(constant, terminates=terminates) == [figures] * TEAMS


def test_an_interval_holds_the_mean_and_figures_repeat():
    results = play(match)
    for figures in results:
        assert figures["mean_ci"][0] <= figures["mean"] <= figures["mean_ci"][1]
    assert results == play(match)
    assert len({figures["mean"] for figures in results}) == TEAMS


def test_teams_are_played_with_their_own_parameters():
    """A team's figures are those it has when it is played alone, to rounding."""
    keys = jax.random.split(jax.random.key(0), TEAMS)
    params = {role: jax.vmap(policy.init)(keys) for role, policy in POLICIES.items()}
    alone = self_play(
        ToyEnv(match),
        POLICIES,
        jax.tree.map(lambda leaf: leaf[1:2], params),
        disability_params(["d1"]),
        keys[1:2],
        16,
    )
    np.testing.assert_allclose(alone[0]["mean"], play(match)[1]["mean"], rtol=1e-5)


def test_figures_are_those_of_a_plain_loop():
    """Oracle: one team, step by step, one policy at a time."""
    keys = jax.random.split(jax.random.key(0), TEAMS)
    env, team = ToyEnv(match), 2
    params = {role: jax.vmap(policy.init)(keys) for role, policy in POLICIES.items()}
    state = env.reset(jax.random.split(keys[team], 16), disability_params(["d1"] * 16))
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
