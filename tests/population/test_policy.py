import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from population.networks.policy import Gaussian, Policy
from population.networks.spec import PolicySpec
from population.networks.unrolled import unroll_policy
from population.play.seats import act_all, initial_carries

SPECS = [
    PolicySpec("robot", 5, 2, "mlp", (16, 8), squash="clip", std="parameter"),
    PolicySpec("robot", 5, 2, "mlp", (16, 8), squash="tanh", std="state", normalise=False),
    PolicySpec("robot", 5, 2, "gru", (16, 8), squash="clip", std="parameter"),
    PolicySpec("robot", 5, 2, "gru", (16, 8), squash="tanh", std="state"),
]


@pytest.mark.parametrize("spec", SPECS, ids=lambda spec: f"{spec.torso}-{spec.squash}")
def test_shapes_follow_the_leading_axes_and_stacked_parameters(spec):
    policy = Policy(spec)
    params = jax.vmap(policy.init)(jax.random.split(jax.random.key(0), 3))
    obs = jax.random.normal(jax.random.key(1), (3, 4, 5, 5))
    first = jnp.ones((3, 4, 5), bool)
    carry, action = jax.vmap(policy.act)(params, policy.initial_carry((3, 4, 5)), obs, first)
    assert action.shape == (3, 4, 5, 2)
    assert jnp.abs(action).max() <= 1.0
    member = jax.tree.map(lambda leaf: leaf[1], params)
    _, alone = policy.act(member, policy.initial_carry(()), obs[1, 2, 3], first[1, 2, 3])
    np.testing.assert_allclose(alone, action[1, 2, 3], rtol=1e-5, atol=1e-7)
    assert isinstance(carry, tuple) == (spec.torso == "mlp")


@pytest.mark.usefixtures("optimised")
@pytest.mark.parametrize("torso", ["mlp", "gru"])
def test_actions_do_not_depend_on_the_number_of_rows(torso):
    """A processor without AVX-512 rounds 2 to 6 rows otherwise than 64 that fill its vectors."""
    policy = Policy(PolicySpec("robot", 34, 7, torso, (128, 128)))
    params = jax.vmap(policy.init)(jax.random.split(jax.random.key(0), 2))
    obs = jax.random.normal(jax.random.key(1), (2, 64, 34))

    @jax.jit
    def act(obs):
        carries = initial_carries([policy], [2], obs.shape[1])
        return act_all([policy], [params], carries, obs, True, None)[1]

    whole = np.asarray(act(obs))
    for rows in (1, 9, 18):
        np.testing.assert_array_equal(act(obs[:, :rows]), whole[:, :rows])


def test_parameters_have_the_names_that_published_files_use():
    params = Policy(PolicySpec("robot", 5, 2, hidden=(16, 8))).init(jax.random.key(0))
    assert set(params) == {"Dense_0", "Dense_1", "Dense_2", "log_std", "normaliser"}
    assert params["Dense_0"]["kernel"].shape == (5, 16)
    assert params["Dense_2"]["kernel"].shape == (8, 2)
    assert set(params["normaliser"]) == {"mean", "std"}


def test_initial_weights_are_orthogonal_with_their_gains():
    params = Policy(PolicySpec("robot", 16, 8, hidden=(16, 16))).init(jax.random.key(0))
    for name, gain in (("Dense_1", np.sqrt(2.0)), ("Dense_2", 0.01)):
        singular = np.linalg.svd(np.asarray(params[name]["kernel"]), compute_uv=False)
        np.testing.assert_allclose(singular, gain, rtol=1e-4)


def test_untrained_policy_acts_around_zero():
    policy = Policy(PolicySpec("robot", 5, 2))
    obs = 3.0 * jax.random.normal(jax.random.key(1), (1000, 5))
    first = jnp.ones(1000, bool)
    params = policy.init(jax.random.key(0))
    _, gaussian = policy.step(params, (), obs, first)
    still = gaussian.mode()
    drawn = gaussian.action(gaussian.sample(jax.random.key(2)))
    assert jnp.abs(still).max() < 0.1
    assert (jnp.abs(drawn) == 1.0).mean() < 0.15


def test_normalising_equals_scaled_observations_and_is_clipped():
    policy = Policy(PolicySpec("robot", 3, 1, hidden=(8,)))
    plain = Policy(PolicySpec("robot", 3, 1, hidden=(8,), normalise=False))
    params = policy.init(jax.random.key(0))
    network = {name: value for name, value in params.items() if name != "normaliser"}
    params["normaliser"] = {"mean": jnp.array([1.0, 2.0, 3.0]), "std": jnp.array([2.0, 0.5, 0.01])}
    obs, first = jnp.array([[3.0, 2.5, 4.0]]), jnp.ones(1, bool)
    np.testing.assert_allclose(
        policy.act(params, (), obs, first)[1],
        plain.act(network, (), jnp.array([[1.0, 1.0, 10.0]]), first)[1],
        rtol=1e-5,
    )


@pytest.mark.parametrize("spec", SPECS[2:], ids=["clip", "tanh"])
def test_carry_resets_at_first_alone(spec):
    policy = Policy(spec)
    params = policy.init(jax.random.key(0))
    obs = jax.random.normal(jax.random.key(1), (6, 2, 5))
    first = jnp.zeros((6, 2), bool).at[0].set(True).at[3].set(True)
    _, whole = unroll_policy(policy, params, policy.initial_carry((2,)), obs, first)
    _, second = unroll_policy(policy, params, policy.initial_carry((2,)), obs[3:], first[3:])
    np.testing.assert_allclose(whole.mean[3:], second.mean, rtol=1e-5, atol=1e-7)
    late = jnp.roll(first, 1, axis=0)
    _, shifted = unroll_policy(policy, params, policy.initial_carry((2,)), obs, late)
    assert jnp.abs(shifted.mean[3:] - second.mean).max() > 1e-5


@pytest.mark.parametrize("squash", ["clip", "tanh"])
def test_log_prob_and_entropy_are_the_densitys(squash):
    """SciPy's density, with the change of variables of tanh; entropy is its mean logarithm."""
    mean, log_std = jnp.array([[0.3, -0.7]]), jnp.array([[-0.5, 0.2]])
    gaussian = Gaussian(mean, log_std, squash)
    raw = gaussian.sample(jax.random.key(0))
    expected = stats.norm.logpdf(np.asarray(raw), np.asarray(mean), np.exp(np.asarray(log_std)))
    if squash == "tanh":
        expected = expected - np.log(1.0 - np.tanh(np.asarray(raw, np.float64)) ** 2)
    np.testing.assert_allclose(gaussian.log_prob(raw), expected.sum(-1), rtol=1e-4)
    many = Gaussian(jnp.full((200_000, 2), 0.4), jnp.full((200_000, 2), -0.3), squash)
    drawn = -many.log_prob(many.sample(jax.random.key(0))).mean()
    np.testing.assert_allclose(many.entropy()[0], drawn, atol=0.01)


def test_squashed_density_integrates_to_one():
    """Without the slope of tanh, the planted defect, it would not."""
    action = np.linspace(-0.9999, 0.9999, 20_001)
    raw = jnp.asarray(np.arctanh(action)[:, None], jnp.float32)
    broad = jnp.zeros_like(raw)
    for squash, total in (("tanh", 1.0), ("clip", None)):
        density = np.exp(np.asarray(Gaussian(broad, broad, squash).log_prob(raw), np.float64))
        integral = np.trapezoid(density, action)
        assert (abs(integral - 1.0) < 0.01) == (total is not None)


@pytest.mark.parametrize("torso", ["mlp", "gru"])
@pytest.mark.parametrize("std", ["parameter", "state"])
def test_policy_starts_with_given_standard_deviation(std, torso):
    policy = Policy(PolicySpec("robot", 5, 2, torso=torso, std=std, hidden=(8, 8)))
    obs, first = jnp.ones((3, 5)), jnp.ones(3, bool)
    for given, log_std in (((), -0.5), ((-2.0,), -2.0)):
        params = policy.init(jax.random.key(0), *given)
        _, gaussian = policy.step(params, policy.initial_carry((3,)), obs, first)
        np.testing.assert_allclose(gaussian.log_std, log_std, atol=0.05)
        assert jnp.abs(gaussian.mean).max() < 0.1
