import jax
import jax.numpy as jnp
import numpy as np
import pytest

from population.networks.policy import Critic, CriticSpec
from population.trainers import gae
from tests.population.toy_env import numpy_gae

STEPS, SIMULATIONS = 12, 5


@pytest.fixture
def chunk():
    rng = np.random.default_rng(0)
    reward, value, next_value = rng.normal(size=(3, STEPS, SIMULATIONS))
    terminated = rng.random((STEPS, SIMULATIONS)) < 0.1
    truncated = (rng.random((STEPS, SIMULATIONS)) < 0.2) & ~terminated
    assert terminated.any() and truncated.any()
    return reward, value, next_value, terminated, truncated


@pytest.mark.parametrize("wrap", [lambda function: function, jax.jit], ids=["plain", "jit"])
def test_advantages_are_those_of_the_definition(chunk, wrap):
    result = wrap(gae.advantages)(*map(jnp.asarray, chunk), 0.97, 0.9)
    np.testing.assert_allclose(result, numpy_gae(*chunk, 0.97, 0.9), rtol=1e-4, atol=1e-5)


def test_a_missing_bootstrap_differs(chunk):
    """The planted defect: a time limit treated as termination."""
    reward, value, next_value, terminated, truncated = map(jnp.asarray, chunk)
    defective = gae.advantages(
        reward, value, next_value, terminated | truncated, jnp.zeros_like(truncated), 0.97, 0.9
    )
    assert np.abs(defective - numpy_gae(*chunk, 0.97, 0.9)).max() > 0.1


def test_nonfinite_value_after_termination_is_ignored():
    ones = jnp.ones((1, 1))
    result = gae.advantages(ones, ones, jnp.full((1, 1), jnp.nan), ones > 0, ones < 0, 0.97, 0.9)
    np.testing.assert_allclose(result, 0.0)


@pytest.mark.slow_for("gru")
@pytest.mark.parametrize("torso", ["mlp", "gru"])
def test_next_values_are_those_before_a_reset(torso):
    """The oracle steps each simulation by hand; the final observation is one more step."""
    critic = Critic(CriticSpec(3, torso, (8, 8)))
    params = critic.init(jax.random.key(0))
    rng = np.random.default_rng(1)
    obs = jnp.asarray(rng.normal(size=(STEPS + 1, SIMULATIONS, 3)), jnp.float32)
    final_obs = jnp.asarray(rng.normal(size=(SIMULATIONS, 3)), jnp.float32)
    truncated = np.zeros((STEPS, SIMULATIONS), bool)
    truncated[[3, 11, 0], [0, 1, 2]] = True
    first = np.concatenate([np.ones((1, SIMULATIONS), bool), truncated])
    carry0 = critic.initial_carry((SIMULATIONS,))
    flags = jnp.asarray(first[:-1]), jnp.asarray(truncated)
    end = final_obs, obs[-1], jnp.asarray(first[-1])
    _, value, next_value = gae.values(critic, params, carry0, obs[:-1], *flags, *end)
    for n in range(SIMULATIONS):
        carry = critic.initial_carry(())
        for t in range(STEPS):
            carry, expected = critic.step(params, carry, obs[t, n], jnp.asarray(first[t, n]))
            np.testing.assert_allclose(value[t, n], expected, rtol=1e-4, atol=1e-5)
            reached = final_obs[n] if truncated[t, n] else obs[t + 1, n]
            _, expected = critic.step(params, carry, reached, jnp.asarray(False))
            np.testing.assert_allclose(next_value[t, n], expected, rtol=1e-4, atol=1e-5)
