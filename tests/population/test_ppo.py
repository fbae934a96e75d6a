import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import disability_params
from population.config import Member
from population.hyperparameters import PPOConfig, preset
from population.networks.policy import normalise
from population.networks.unrolled import unroll_both
from population.play.self_play import self_play
from population.runs.train import member_key
from population.trainers.normaliser import to_params
from population.trainers.ppo import PPO
from tests.population.toy_env import ToyEnv, constant, match, together

# Programs this small take longer to compile than to run.
FAST_COMPILE = {"xla_backend_optimization_level": 0}
SMALL: dict[str, Any] = {"num_envs": 32, "rollout_steps": 10, "hidden": (16, 16)}
SMALL |= {"learning_rate": 1e-2, "gamma": 0.9}
MEMBER = Member(0, "d1")


def start(env, config, members=(MEMBER,), updates=100, kind=PPO):
    ppo = kind(config, env, updates)
    keys = jnp.stack([member_key(member) for member in members])
    settings = [member.disability for member in members for _ in range(config.num_envs)]
    initial = jax.jit(ppo.initial, compiler_options=FAST_COMPILE)
    return ppo, initial(keys, disability_params(settings)), ppo.hyper(members)


def run(env, config, members=(MEMBER,), updates=100, kind=PPO):
    ppo, state, hyper = start(env, config, members, updates, kind)
    scan = partial(jax.lax.scan, lambda state, _: ppo.update(state, hyper), length=updates)
    return ppo, *jax.jit(scan, compiler_options=FAST_COMPILE)(state)


def networks(state):
    return {role: learner.networks for role, learner in state.members.learners.items()}


def assert_same(left, right):
    assert jax.tree.structure(left) == jax.tree.structure(right)
    for path, leaf in jax.tree_util.tree_leaves_with_path(left):
        other = dict(jax.tree_util.tree_leaves_with_path(right))[path]
        np.testing.assert_array_equal(leaf, other, err_msg=jax.tree_util.keystr(path))


def deterministic_return(env, ppo, state, count=1):
    keys, humans = jax.random.split(jax.random.key(7), count), disability_params(["d1"] * count)
    return self_play(env, ppo.policies, ppo.policy_params(state.members), humans, keys, 8)


@pytest.mark.slow
@pytest.mark.parametrize("terminates", [False, True], ids=["time-limit", "planted-termination"])
def test_constant_reward_value_bootstraps_at_time_limit(terminates):
    """The value is 1 / (1 - gamma) = 10 at a time limit; the planted termination lowers it."""
    env = ToyEnv(constant, terminates=terminates)
    ppo, state, metrics = run(env, PPOConfig(**{**SMALL, "gae_lambda": 0.8}))
    learner = state.members.learners["robot"]
    stats = jax.tree.map(lambda leaf: leaf[0], to_params(state.members.statistics["robot"]))
    obs = normalise(stats, state.simulations.env.obs["robot"])
    critic = jax.tree.map(lambda leaf: leaf[0], learner.networks["critic"])
    _, value = ppo.critics["robot"].step(critic, (), obs, state.simulations.first)
    if terminates:
        assert value.mean() < 8.0
    else:
        np.testing.assert_allclose(value, 10.0, atol=0.5)
    finished = np.asarray(metrics["return"])[np.asarray(metrics["episodes"]) > 0]
    # Partial first episodes are not counted.
    np.testing.assert_array_equal(finished, float(env.episode_length))


@pytest.mark.parametrize(("paid", "share"), [(1.0, 1.0), (0.5, 0.0)])
def test_success_at_any_step_counts(paid, share):
    """The toy's goal holds above a reward of 0.9: here in the third step of thirteen, or never."""
    env = ToyEnv(lambda state, action: {"once": paid * (state.step == 2)}, episode_length=13)
    _, _, metrics = run(env, PPOConfig(**SMALL), updates=3)
    ended = np.asarray(metrics["episodes"]) > 0
    assert ended.any()
    np.testing.assert_array_equal(np.asarray(metrics["success"])[ended], share)


SQUASHED = {"squash": "tanh", "std": "state", "normalise": False}


@pytest.mark.slow_for("mappo", "tanh")
@pytest.mark.parametrize(
    ("algorithm", "reward", "changes"),
    [("ippo", match, {}), ("ippo", match, SQUASHED), ("mappo", together, {"clip_eps": 0.2})],
    ids=["ippo-match", "ippo-match-tanh", "mappo-together"],
)
def test_both_roles_learn_from_their_observations(algorithm, reward, changes):
    env = ToyEnv(reward)
    # Not 100 updates: at the optimum, advantages are noise, which large steps follow anywhere.
    config = preset(algorithm, **{**SMALL, "rollout_steps": 20, **changes})
    ppo, state, _ = run(env, config, updates=50)
    (figures,) = deterministic_return(env, ppo, state)
    assert figures["mean"] > 0.95 * env.episode_length
    assert figures["n"] == 8


@pytest.mark.slow
def test_recurrent_team_beats_feed_forward_at_memory():
    env = ToyEnv(match, episode_length=12, memory=True)
    config = PPOConfig(**{**SMALL, "learning_rate": 3e-3}, torso="gru")
    ppo, state, _ = run(env, config, updates=150)
    (figures,) = deterministic_return(env, ppo, state)
    assert figures["mean"] > 0.9 * env.episode_length  # without memory the best is half of it


@pytest.mark.slow
@pytest.mark.parametrize("planted", [False, True], ids=["aligned", "planted-shift"])
def test_learning_replays_the_policy_that_acted(planted, monkeypatch):
    """The first ratios of an update are 1: carries and `first` flags are those of the rollout."""
    if planted:
        monkeypatch.setattr(
            "population.trainers.ppo.unroll_both",
            lambda *given: unroll_both(*given[:-1], jnp.roll(given[-1], 1, 0)),
        )
    config = PPOConfig(**SMALL, torso="gru", epochs=1, minibatches=1)
    _, _, metrics = run(ToyEnv(match, episode_length=13, memory=True), config, updates=30)
    largest = np.abs(metrics["approx_kl_robot"]).max()
    assert (largest > 1e-4) == planted


class Coupled(PPO):
    """A planted defect: the human's clip shrinks with the robot's critic, as a shared one does."""

    def _learn_role(self, name, member, batch, hyper, key):
        if name == "human":
            robot = member.learners["robot"].networks["critic"]
            norm = sum(jnp.abs(leaf).sum() for leaf in jax.tree.leaves(robot))
            hyper = {**hyper, "max_grad_norm": hyper["max_grad_norm"] / norm}
        return super()._learn_role(name, member, batch, hyper, key)


@pytest.mark.parametrize("kind", [PPO, Coupled])
def test_role_ignores_the_other_roles_gradients(kind):
    ppo, state, hyper = start(ToyEnv(match), PPOConfig(**SMALL), kind=kind)
    robot = state.members.learners["robot"]
    critic = jax.tree.map(lambda leaf: 1000.0 * leaf, robot.networks["critic"])
    louder = dataclasses.replace(robot, networks={**robot.networks, "critic": critic})
    members = dataclasses.replace(
        state.members, learners={**state.members.learners, "robot": louder}
    )
    update = jax.jit(ppo.update, compiler_options=FAST_COMPILE)
    after, _ = update(state, hyper)
    after_louder, _ = update(dataclasses.replace(state, members=members), hyper)
    same = [networks(state)["human"] for state in (after, after_louder)]
    if kind is PPO:
        assert_same(*same)
    else:
        with pytest.raises(AssertionError):
            assert_same(*same)


@pytest.mark.slow
@pytest.mark.parametrize("platform", ["cpu", "gpu"])
def test_member_ignores_other_members(platform, monkeypatch):
    """Taken in turn, as on a CPU, or vectorised, as on an accelerator."""
    config = PPOConfig(**SMALL)
    changes = {"learning_rate": 3e-3, "gamma": 0.8}
    members = (Member(0, "d1"), Member(4, "d9", changes), Member(4, "d1"))
    alone_config = dataclasses.replace(config, **changes)
    _, alone, _ = run(ToyEnv(match), alone_config, (Member(4, "d9"),), updates=3)
    monkeypatch.setattr(jax, "default_backend", lambda: platform)
    _, beside, _ = run(ToyEnv(match), config, members, updates=3)
    both = [networks(state) for state in (beside, alone)]
    # Two programs round differently.
    assert_close = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5)
    jax.tree.map(lambda many, alone: assert_close(many[1:2], alone), *both)
    with pytest.raises(AssertionError):
        jax.tree.map(lambda many, alone: assert_close(many[2:3], alone), *both)


class Diverging(ToyEnv):
    """Physics that diverge in some simulations at their third step: frozen, with reward 0."""

    def step(self, state, action):
        after = super().step(state, action)
        nonfinite = state.nonfinite | ((after.step == 3) & (after.cue["robot"] > 0))
        return dataclasses.replace(
            after, nonfinite=nonfinite, reward=jnp.where(nonfinite, 0.0, after.reward)
        )


@pytest.mark.slow
def test_simulations_that_diverge_are_counted_and_start_again():
    env = Diverging(constant)
    ppo, state, hyper = start(env, PPOConfig(**SMALL))
    update = jax.jit(ppo.update, compiler_options=FAST_COMPILE)
    for _ in range(3):
        state, metrics = update(state, hyper)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.members.learners))
    assert metrics["nonfinite"][0] > 0
    assert not state.simulations.env.nonfinite.any()


def test_learning_rate_falls_to_nothing_when_annealed():
    config = PPOConfig(**SMALL, anneal_lr=True)
    ppo, state, hyper = start(ToyEnv(match), config, updates=4)
    state = dataclasses.replace(state, update=jnp.asarray(4, jnp.int32))
    after, _ = jax.jit(ppo.update, compiler_options=FAST_COMPILE)(state, hyper)
    assert_same(networks(after)["robot"], networks(state)["robot"])


@pytest.mark.slow
def test_the_entropy_bonus_falls_to_nothing_when_annealed():
    """A large bonus makes noise grow. When a run is over it is worth nothing: noise shrinks."""
    spread = {}
    for annealed in (False, True):
        config = PPOConfig(**SMALL, entropy_coef=10.0, anneal_entropy=annealed)
        ppo, state, hyper = start(ToyEnv(match), config, updates=4)
        before = state.members.learners["robot"].networks["actor"]["log_std"]
        state = dataclasses.replace(state, update=jnp.asarray(4, jnp.int32))
        after, _ = jax.jit(ppo.update, compiler_options=FAST_COMPILE)(state, hyper)
        grown = after.members.learners["robot"].networks["actor"]["log_std"] - before
        spread[annealed] = float(grown.mean())
    assert spread[False] > 0.1 > 0.0 > spread[True]


def test_starts_are_spread_over_the_episode():
    _, state, _ = start(ToyEnv(match), PPOConfig(**SMALL))
    assert len(np.unique(state.simulations.env.step)) > 10


def test_a_rollout_longer_than_an_episode_is_refused():
    with pytest.raises(ValueError, match="rollout_steps is 64; an episode of toy has 20 steps"):
        PPO(PPOConfig(), ToyEnv(match), 1)
