"""The recurrence with a gradient of its own is that of the cell, step by step."""

import jax
import jax.numpy as jnp
import pytest

from population.networks.policy import Critic, CriticSpec, Policy
from population.networks.spec import PolicySpec
from population.networks.unrolled import unroll_both, unroll_critic, unroll_memory, unroll_policy

T, N = 24, 6
SPECS = (
    PolicySpec("robot", 5, 2, torso="gru", hidden=(8, 16)),
    PolicySpec("robot", 5, 2, torso="gru", hidden=(16,), std="state", squash="tanh"),
)


@pytest.fixture(params=SPECS, ids=["two widths", "state-dependent deviation"])
def policy(request: pytest.FixtureRequest) -> Policy:
    return Policy(request.param)


def unrolled(policy: Policy, params, first, *, by_step: bool):
    """Return carry and outputs over T steps, by the cell itself or all at once."""
    obs = jax.random.normal(jax.random.key(1), (T, N, 5))
    carry = jax.random.normal(jax.random.key(2), policy.initial_carry((N,)).shape)
    if by_step:
        return jax.lax.scan(lambda c, x: policy.step(params, c, *x), carry, (obs, first))
    return unroll_policy(policy, params, carry, obs, first)


def params_and_first(policy: Policy):
    first = jax.random.bernoulli(jax.random.key(3), 0.1, (T, N))
    return policy.init(jax.random.key(0)), first


def test_outputs_are_those_of_the_cell(policy: Policy) -> None:
    params, first = params_and_first(policy)
    pair = (unrolled(policy, params, first, by_step=by_step) for by_step in (True, False))
    for expected, value in zip(*map(jax.tree.leaves, pair), strict=True):
        assert jnp.allclose(expected, value, atol=1e-6)


def test_gradients_are_those_of_the_cell(policy: Policy) -> None:
    params, first = params_and_first(policy)

    def loss(params, by_step: bool):
        carry, gaussian = unrolled(policy, params, first, by_step=by_step)
        return gaussian.log_prob(jnp.full((T, N, 2), 0.3)).mean() + jnp.square(carry).mean()

    expected, gradient = (jax.grad(loss)(params, by_step) for by_step in (True, False))
    for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(gradient), strict=True):
        assert jnp.linalg.norm(a - b) <= 2e-6 * jnp.linalg.norm(a) + 1e-9


@pytest.mark.slow_for("two")
@pytest.mark.parametrize("width", [16, 4], ids=["one scan", "two, of other widths"])
def test_policy_and_critic_together_are_those_apart(policy: Policy, width: int) -> None:
    first = params_and_first(policy)[1]
    critic = Critic(CriticSpec(7, "gru", (8, width)))
    params = policy.init(jax.random.key(0)), critic.init(jax.random.key(5))
    networks, keys = (policy, critic), jax.random.split(jax.random.key(6), 4)
    carries = tuple(
        jax.random.normal(key, network.initial_carry((N,)).shape)
        for key, network in zip(keys[:2], networks, strict=True)
    )
    obs = jax.random.normal(keys[2], (T, N, 5)), jax.random.normal(keys[3], (T, N, 7))

    def apart(params):
        gaussian = unroll_policy(policy, params[0], carries[0], obs[0], first)[1]
        return gaussian, unroll_critic(critic, params[1], carries[1], obs[1], first)[1]

    def together(params):
        return unroll_both(policy, critic, params, carries, obs, first)

    def loss(play, params):
        gaussian, value = play(params)
        return gaussian.log_prob(jnp.full((T, N, 2), 0.3)).mean() + jnp.square(value).mean()

    for a, b in zip(jax.tree.leaves(apart(params)), jax.tree.leaves(together(params)), strict=True):
        assert jnp.allclose(a, b, atol=1e-6)
    gradients = (jax.grad(loss, argnums=1)(play, params) for play in (apart, together))
    for a, b in zip(*map(jax.tree.leaves, gradients), strict=True):
        assert jnp.linalg.norm(a - b) <= 2e-6 * jnp.linalg.norm(a) + 1e-9


def test_carry_resets_at_episode_start_after_divergence(policy: Policy) -> None:
    params, _ = params_and_first(policy)
    first = jnp.zeros((T, N), bool).at[0].set(True)

    def total(params, carry):
        obs = jnp.ones((T, N, 5))
        return unroll_policy(policy, params, carry, obs, first)[1].mean.sum()

    diverged = jnp.full(policy.initial_carry((N,)).shape, jnp.nan)
    gradient = jax.grad(total)(params, diverged)
    assert all(jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


@pytest.mark.slow_for("two")
def test_members_side_by_side_have_their_own_gradients(policy: Policy) -> None:
    _, first = params_and_first(policy)
    stacked = jax.vmap(policy.init)(jax.random.split(jax.random.key(4), 3))

    def loss(params):
        return jnp.square(unrolled(policy, params, first, by_step=False)[1].mean).mean()

    whole = jax.vmap(jax.grad(loss))(stacked)
    gradient = jax.grad(loss)(jax.tree.map(lambda leaf: leaf[1], stacked))
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(gradient), strict=True):
        assert jnp.allclose(a[1], b, rtol=1e-5, atol=1e-8)


@pytest.mark.slow_for("clip")
@pytest.mark.parametrize("squash", ["clip", "tanh"])
def test_a_memory_unrolls_as_it_acts(squash: str) -> None:
    """Latents of a rollout are those that acted, whatever actions were drawn."""
    policy = Policy(PolicySpec("robot", 5, 2, hidden=(8, 16), squash=squash, latent=3))
    params, first = params_and_first(policy)
    obs = jax.random.normal(jax.random.key(1), (T, N, 5))
    drawn = jax.random.uniform(jax.random.key(4), (T, N, 2), minval=-1.0)
    carry = jax.random.normal(jax.random.key(2), policy.initial_carry((N,)).shape)
    given, latents, mode = carry, [], None
    for t in range(T):
        latents.append(policy.recall(params, given, obs[t], first[t])[1])
        given, gaussian = policy.step(params, given, obs[t], first[t])
        mode, given = gaussian.mean, policy.acted(given, drawn[t])
    states, unrolled = unroll_memory(policy, params, carry, obs, first, drawn)
    assert jnp.allclose(jnp.stack(latents), unrolled, atol=1e-5)
    assert jnp.allclose(states[-1], given[:, :16], atol=1e-5)
    assert jnp.allclose(policy.given(params, obs, unrolled).mean[-1], mode, atol=1e-5)
