from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from population.config import Member
from population.hyperparameters import PPOConfig, preset
from population.networks import shared_network
from population.networks.policy import Policy
from population.networks.spec import ROLES, PolicySpec
from population.trainers.ppo import PPO
from tests.population.test_ppo import SMALL, deterministic_return, run
from tests.population.toy_env import ToyEnv, match, together

SIZES = {"robot": (5, 2), "human": (7, 3)}
VARIANTS: dict[str, dict[str, Any]] = {
    "mlp": {},
    "state-std": {"std": "state", "squash": "tanh"},
    "gru": {"torso": "gru"},
}


def pad(obs: jax.Array, role: str, width: int) -> jax.Array:
    """Return the shared network's input [..., width] of obs [..., O]."""
    row = jnp.eye(len(ROLES))[ROLES.index(role)]
    one_hot = jnp.broadcast_to(row, (*obs.shape[:-1], len(ROLES)))
    blank = jnp.zeros((*obs.shape[:-1], width - obs.shape[-1] - len(ROLES)))
    return jnp.concatenate([obs, blank, one_hot], axis=-1)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("role", ["robot", "human"])
def test_exported_policy_equals_the_shared_network(role, variant):
    """The shared network reads [obs, 0, one-hot]; the role's ordinary policy reads obs."""
    observation, action = SIZES[role]
    width = shared_network.padded_size({role: sizes[0] for role, sizes in SIZES.items()})
    assert width == 9
    options = {"hidden": (8, 6), "normalise": False, **VARIANTS[variant]}
    shared = Policy(PolicySpec("robot", width, 3, **options))
    own = Policy(PolicySpec(role, observation, action, **options))
    keys = jax.random.split(jax.random.key(2), 3)
    leaves, tree = jax.tree.flatten(jax.eval_shape(shared.init, keys[0]))
    draws = zip(jax.random.split(keys[1], len(leaves)), leaves, strict=True)
    params = jax.tree.unflatten(tree, [jax.random.normal(key, leaf.shape) for key, leaf in draws])
    folded = shared_network.fold(params, role, observation, action)
    expected = jax.eval_shape(own.init, keys[0])
    assert jax.tree.map(np.shape, folded) == jax.tree.map(np.shape, expected)
    obs, first = jax.random.normal(keys[2], (4, observation)), jnp.zeros(4, bool)
    _, expected = shared.step(params, shared.initial_carry((4,)), pad(obs, role, width), first)
    _, actual = own.step(folded, own.initial_carry((4,)), obs, first)
    np.testing.assert_allclose(actual.mean, expected.mean[:, :action], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(actual.log_std, expected.log_std[:, :action], rtol=1e-4, atol=1e-5)
    other = "human" if role == "robot" else "robot"
    _, different = shared.step(params, shared.initial_carry((4,)), pad(obs, other, width), first)
    assert not np.allclose(actual.mean, different.mean[:, :action], atol=1e-3)


def test_roles_share_one_network_and_keep_their_specs():
    config = PPOConfig(**SMALL, shared=True)
    ppo = PPO(config, ToyEnv(match), 1)
    settings = disability_params(["d1"] * config.num_envs)
    state = jax.eval_shape(ppo.initial, jax.random.split(jax.random.key(0), 1), settings)
    after, metrics = jax.eval_shape(ppo.update, state, ppo.hyper([Member(0, "d1")]))
    assert list(after.members.learners) == ["shared"]
    params = jax.eval_shape(ppo.policy_params, after.members)
    assert params["robot"]["Dense_0"]["kernel"].shape == (1, 2, 16)
    assert params["human"]["Dense_2"]["bias"].shape == (1, 2)
    assert {"policy_loss_robot", "policy_loss_human", "actor_grad_norm_shared"} <= set(metrics)


@pytest.mark.parametrize(
    ("algorithm", "reward", "changes"),
    [
        ("ippo", match, {}),
        ("mappo", together, {"clip_eps": 0.2}),
        ("ippo", match, {"torso": "gru", "learning_rate": 3e-3}),
    ],
    ids=["ippo-match", "mappo-together", "ippo-gru-match"],
)
@pytest.mark.slow
def test_a_shared_network_learns_both_roles(algorithm, reward, changes):
    env = ToyEnv(reward)
    config = preset(algorithm, **{**SMALL, "rollout_steps": 20, "shared": True, **changes})
    ppo, state, _ = run(env, config, updates=150 if changes.get("torso") else 100)
    (figures,) = deterministic_return(env, ppo, state)
    assert figures["mean"] > 0.92 * env.episode_length


def test_a_shared_recurrent_network_needs_an_embedding():
    with pytest.raises(ValueError, match="give at least two widths"):
        PPOConfig(shared=True, torso="gru", hidden=(8,))
