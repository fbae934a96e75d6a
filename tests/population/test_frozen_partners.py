"""Egos: one role learns, frozen partners sit in the other seat."""

import dataclasses
import json
from functools import partial
from operator import itemgetter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_envs import DISABILITY_SETTINGS, disability_params
from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import PPOConfig, SACConfig
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from population.partners.frozen import FrozenPartners, fitting_envs
from population.runs.train import initial_state, train
from population.trainers.ppo import PPO
from population.trainers.sac import SAC
from tests.population import test_sac
from tests.population.test_ppo import FAST_COMPILE, SMALL
from tests.population.toy_env import ToyEnv, match

PLAIN = PolicySpec("human", 3, 2, hidden=(8,))
SQUASHED = PolicySpec("human", 3, 2, hidden=(4, 4), squash="tanh", std="state", normalise=False)


def stack(spec, names, seed=0):
    keys = jax.random.split(jax.random.key(seed), len(names))
    trees = [Policy(spec).init(key) for key in keys]
    params = jax.tree.map(lambda *leaves: 3.0 * np.stack(leaves) + 0.1, *trees)
    return PolicyStack(spec, tuple(names), params)


def frozen(stacks, settings):
    return FrozenPartners(stacks, {name: DISABILITY_SETTINGS[d] for name, d in settings.items()})


def population(first="a"):
    stacks = [stack(PLAIN, (first, "b")), stack(SQUASHED, ("c",), seed=1)]
    return frozen(stacks, {first: "d1", "b": "d3", "c": "d9"})


def config(kind, members=2, **changes):
    trainer = (
        PPOConfig(**{**SMALL, "num_envs": 12, "minibatches": 2, **changes})
        if kind is PPO
        else SACConfig(**{**test_sac.SMALL, "num_envs": 12, "replay_size": 3000, **changes})
    )
    team = tuple(Member(seed, MIXED) for seed in range(members))
    return TrainConfig(
        "toy", "ego", team, trainer.batch_steps * 100, trainer, partners=("a", "b", "c")
    )


@pytest.mark.parametrize("platform", ["cpu", "gpu"])
def test_partner_acts_in_its_share_alone(platform, monkeypatch):
    """Simulations are [member, partner, simulation]; the oracle asks partners one by one."""
    partners, members, share = population(), 2, 2
    monkeypatch.setattr(jax, "default_backend", lambda: platform)
    obs = jax.random.normal(jax.random.key(5), (members * 3 * share, 3))
    first = jnp.zeros(len(obs), bool)
    carry = partners.initial_carry(len(obs))
    _, action = partners.act(partners.params, carry, obs, first, members)
    assert action.shape == (12, 2)
    for row in range(len(obs)):
        name = partners.ids[row // share % 3]
        [group] = [group for group in partners.stacks if name in group.ids]
        params = jax.tree.map(itemgetter(group.ids.index(name)), group.params)
        _, expected = Policy(group.spec).act(params, (), obs[row], first[row])
        np.testing.assert_allclose(action[row], expected, rtol=1e-5, atol=1e-6)


def test_partners_have_their_disability_and_named_preferences():
    run = dataclasses.replace(config(PPO), task="gentle_lift", preferences=("p2", "p9", "p4"))
    state = initial_state(run, PPO(run.trainer, ToyEnv(match), 1, population()))
    # Axes: member, partner, simulation.
    likes = state.simulations.env.params.preference_code.reshape(2, 3, 4)
    expected = [[2, 9, 4, 2], [9, 4, 2, 9], [4, 2, 9, 4]]
    np.testing.assert_array_equal(likes, [expected, expected])
    settings = np.tile(np.repeat(["d1", "d3", "d9"], 4), 2).tolist()
    expected, found = disability_params(settings), state.simulations.env.params
    for name in ("strength", "elbow_range"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    drawn = initial_state(config(PPO), PPO(run.trainer, ToyEnv(match), 1, population()))
    assert not drawn.simulations.env.params.preference_code.any()
    assert TrainConfig.from_json(json.loads(json.dumps(run.to_json()))) == run
    assert "preferences" not in config(PPO).to_json()  # so that older runs go on


@pytest.mark.parametrize(
    ("task", "names", "partners", "message"),
    [
        ("scratch", ("p1",), ("a",), "scratch have no preferences"),
        ("gentle_lift", ("p10",), ("a",), "preferences are p10"),
        ("gentle_lift", ("p1", "p1"), ("a",), "preferences are p1, p1"),
        ("gentle_lift", ("p1",), (), "a team's are drawn"),
    ],
)
def test_preferences_that_nobody_can_have_are_refused(task, names, partners, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(config(PPO), task=task, preferences=names, partners=partners)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [PPO, SAC])
def test_ego_learns_while_partners_stay_frozen(kind):
    run, env, partners = config(kind, members=1), ToyEnv(match), population()
    updates = 100 if kind is PPO else 250
    trainer = kind(run.trainer, env, updates, partners)
    assert list(trainer.specs) == ["robot"]
    state, hyper = initial_state(run, trainer), trainer.hyper(run.members)
    step = lambda state, _: trainer.update(state, hyper, partners.params)  # noqa: E731
    scan = partial(jax.lax.scan, step, length=updates)
    state, metrics = jax.jit(scan, compiler_options=FAST_COMPILE)(state)
    assert list(state.members.learners) == ["robot"]
    earned = np.asarray(metrics["term_robot"])[np.asarray(metrics["episodes"]) > 0]
    # Actions are drawn with the policy's noise.
    assert earned[-10:].mean() > 0.8 * 0.5 * env.episode_length > earned[0] + 1.0


@pytest.mark.parametrize(
    ("preset", "partners", "minibatches", "fitting"),
    [
        *((1024, 16, 4, 1024), (1024, 99, 4, 1188), (1024, 59, 4, 944)),
        *((64, 99, 1, 99), (64, 59, 1, 59), (8, 99, 4, 396)),
    ],
)
def test_fitting_envs_is_nearest_to_the_preset(preset, partners, minibatches, fitting):
    assert fitting_envs(preset, partners, minibatches) == fitting


def test_with_more_partners_than_simulations_each_has_one():
    """99 partners of three specs, as egos of a zoo of several algorithms meet them."""
    specs = PLAIN, SQUASHED, dataclasses.replace(PLAIN, hidden=(5, 4))
    names = [[f"{index}-{row}" for row in range(33)] for index in range(3)]
    stacks = [stack(specs[index], names[index], seed=index) for index in range(3)]
    partners = frozen(stacks, dict.fromkeys([n for stack in stacks for n in stack.ids], "d1"))
    count = fitting_envs(64, len(partners))
    partners.check(ToyEnv(match), count)
    obs = jax.random.normal(jax.random.key(2), (2 * count, 3))
    carry = partners.initial_carry(len(obs))
    _, action = partners.act(partners.params, carry, obs, jnp.zeros(len(obs), bool), 2)
    for row in (0, 32, 33, 98, 99, 197):
        spec, params = specs[row % 99 // 33], stacks[row % 99 // 33].params
        params = jax.tree.map(itemgetter(row % 33), params)
        _, expected = Policy(spec).act(params, (), obs[row], jnp.zeros((), bool))
        np.testing.assert_allclose(action[row], expected, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_run_of_egos_has_no_self_play(tmp_path):
    run = dataclasses.replace(config(PPO), steps=240, checkpoint_every=1)
    folder = train(run, ToyEnv(match), tmp_path / "run", partners=population())
    egos = json.loads((folder / "teams.json").read_text())
    named = [(ego["team"]["seed"], ego["team"]["disability"]) for ego in egos]
    assert named == [(0, MIXED), (1, MIXED)]
    assert list(egos[0]["roles"]) == ["robot"] and egos[0]["self_play"] is None
    with pytest.raises(ValueError, match="another configuration: partners"):
        other = population("x")
        train(dataclasses.replace(run, partners=other.ids), ToyEnv(match), folder, partners=other)


@pytest.mark.parametrize(
    ("changes", "trainer", "message"),
    [
        ({"partners": ()}, {}, "are not those that the configuration names"),
        ({"members": (Member(0, "d1"),)}, {}, "an ego with partners has 'mixed'"),
        ({}, {"num_envs": 32}, "32 with 3 partners; .* a multiple of 3, such as 33"),
        ({}, {"shared": True}, "partners are frozen and one role learns"),
        ({"trainer": config(SAC, critic="central").trainer}, {}, "choose local"),
        ({}, {}, r"partner a has observation and action size \(3, 2\)"),
    ],
)
def test_unfitting_run_is_refused(changes, trainer, message, tmp_path):
    env = ToyEnv(match) if changes or trainer else ToyEnv(match, observation_size=(2, 4, 4))
    run = config(PPO)
    if trainer:
        run = dataclasses.replace(run, trainer=dataclasses.replace(run.trainer, **trainer))
    with pytest.raises(ValueError, match=message):
        train(dataclasses.replace(run, **changes), env, tmp_path / "run", partners=population())
    assert not (tmp_path / "run").exists()


def test_a_partner_without_a_setting_is_refused():
    with pytest.raises(ValueError, match="partner a has no disability setting"):
        FrozenPartners([stack(PLAIN, ("a",))], {})
