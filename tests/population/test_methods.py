"""Methods beside PPO: each wins where its idea is needed, and loses nothing where it is not."""

import dataclasses
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import safetensors.numpy

from assistax_envs.persons import PersonPlayer, numbers, persons
from assistax_envs.persons.rows import marked
from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import PPOConfig, robot_preset
from population.method_presets import METHODS
from population.methods.hidden import HIDDEN, WHO, WithHidden
from population.methods.method import Method, method_class, register
from population.networks.policy import Policy
from population.networks.spec import PolicySpec, spec_from_json
from population.partners.drawn_persons import DrawnPersons
from population.runs.train import initial_state, train
from population.runs.trained import read_trained_run
from population.trainers.ppo import PPO
from tests.population.hidden_env import (
    LENGTH,
    OWN,
    PARTNERS,
    HiddenBit,
    LateSight,
    Settings,
    noisy,
    partners,
)
from tests.population.test_ppo import FAST_COMPILE, SMALL
from tests.population.test_train import Killed, kill_after
from tests.population.toy_env import ToyEnv, match

NAMES = ("asymmetric", "asymmetric_gru", "liam", "osi", "palm", "rma", "rl2")
PROBE: dict[str, Any] = {**SMALL, "learning_rate": 3e-3, "num_envs": 64, "gamma": 0.5}
TINY: dict[str, Any] = {"num_envs": 8, "rollout_steps": 5, "minibatches": 2, "hidden": (8, 8)}


def run_of(algorithm, updates, members=1, **changes):
    """Return a run of some updates with the four partners of the probes."""
    config = robot_preset(algorithm, **{**PROBE, **changes})
    team = tuple(Member(seed, MIXED) for seed in range(members))
    steps = config.batch_steps * updates
    options = {"partners": PARTNERS, "self_play_episodes": 0}
    return TrainConfig("toy", algorithm, team, steps, config, **options)


def learn(env, algorithm, updates, others=None, **changes):
    """Return the trainer, the states before and after some updates, and their metrics [U, M]."""
    run, others = run_of(algorithm, updates, **changes), others or partners()
    trainer = PPO(run.trainer, env, updates, others)
    state, hyper = initial_state(run, trainer), trainer.hyper(run.members)
    step = lambda state, _: trainer.update(state, hyper, others.params)  # noqa: E731
    scan = partial(jax.lax.scan, step, length=updates)
    after, metrics = jax.jit(scan, compiler_options=FAST_COMPILE)(state)
    return trainer, state, after, metrics


def last(metrics, name):
    """Return the mean of a metric over the last fifth of the updates."""
    values = np.asarray(metrics[name])
    return np.nanmean(values[-len(values) // 5 :])


@pytest.mark.slow
def test_asymmetric_critic_explains_partner_rewards():
    """A partner brings up to 80 times what the robot's own act is worth, whatever it does."""
    env = ToyEnv(noisy, episode_length=LENGTH)
    earned = {
        name: last(learn(env, name, 30, num_envs=32)[3], "term_own") / OWN / LENGTH
        for name in ("ppo", "asymmetric", "asymmetric_gru")
    }
    assert earned["asymmetric"] > max(0.6, earned["ppo"] + 0.3)
    assert earned["asymmetric_gru"] > max(0.6, earned["ppo"] + 0.3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["liam", "palm"])
def test_predicting_memory_remembers_the_partners_bit(name):
    metrics = learn(HiddenBit(), name, 60)[3]
    assert last(metrics, "return") > 0.6 * LENGTH  # without memory 1 at most: its only sight
    assert last(metrics, "model_loss_robot") < 0.3 < 0.8 < metrics["model_loss_robot"][0, 0]


@pytest.mark.slow
def test_identification_acts_by_what_it_read():
    """Half of the setting pays, and is seen in the second step alone; the rest shows nowhere."""
    metrics = learn(Settings(), "osi", 100)[3]
    assert last(metrics, "return") > 0.6 * LENGTH
    assert last(metrics, "model_loss_robot") < 0.5 < 0.8 < metrics["model_loss_robot"][0, 0]


@pytest.mark.slow
def test_a_student_does_what_its_teacher_is_told():
    """The teacher is told the setting, which pays; the student sees it in the second step alone."""
    metrics = learn(Settings(), "rma", 100)[3]
    taught = np.asarray(metrics["return"])[50:60].mean()
    assert taught > LENGTH - 1.0  # more than whoever has to look can earn
    assert last(metrics, "return") > 0.7 * LENGTH  # in the last 40 updates the student acts
    # Other seeds, as other processors, end at 0.10 to 0.14.
    errors = metrics["student_latent_error_robot"]
    assert last(metrics, "student_latent_error_robot") < 0.2 < 1.0 < errors[0, 0]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seen"), [("ppo", 2), ("rma", 1)])
def test_who_learns_no_more_reads_observations_as_before(name, seen):
    """While the student acts the policy stays, and so does what normalises observations."""
    more = {"student_share": 0.5} if name == "rma" else {}
    trainer, _, after, _ = learn(HiddenBit(), name, 2, **TINY, **more)
    batch = trainer.config.num_envs * trainer.config.rollout_steps
    counts = [float(s.count[0]) for s in after.members.statistics.values()]
    assert set(counts) == {seen * batch}


@pytest.mark.slow
@pytest.mark.parametrize(("series", "earns"), [(3, True), (1, False)])
def test_memory_carries_into_the_next_episode(series, earns):
    """With series of 1, the ablation, a robot forgets the bit as soon as it has seen it."""
    metrics = learn(LateSight(), "rl2", 120, series=series)[3]
    assert (last(metrics, "return") > 0.4 * LENGTH) == earns


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo", *NAMES])
def test_nothing_is_lost_where_nothing_is_hidden(name):
    metrics = learn(ToyEnv(match, episode_length=LENGTH), name, 60)[3]
    assert last(metrics, "term_robot") > 0.75 * 0.5 * LENGTH > metrics["term_robot"][1, 0] + 1.0


@pytest.mark.slow
@pytest.mark.parametrize(("weight", "learns"), [(0.0, False), (1.0, True)])
def test_nothing_but_its_own_loss_trains_a_memory(weight, learns):
    """With weight 0, the ablation, policy and critic learn and the memory stays as it was."""
    _, before, after, _ = learn(HiddenBit(), "liam", 2, aux_coef=weight, **TINY)
    old, new = (s.members.learners["robot"].networks["memory"] for s in (before, after))
    same = jax.tree.leaves(jax.tree.map(np.array_equal, old, new))
    assert (not all(same)) == learns


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_killed_run_resumes_exactly_and_writes_the_actor(name, tmp_path):
    run = dataclasses.replace(run_of(name, 6, members=2, **TINY), checkpoint_every=2)
    whole = train(run, HiddenBit(), tmp_path / "whole", partners=partners())
    with pytest.raises(Killed):
        train(run, HiddenBit(), tmp_path / "killed", partners=partners(), progress=kill_after(5))
    killed = train(run, HiddenBit(), tmp_path / "killed", partners=partners())
    content = (whole / "robot.safetensors").read_bytes()
    assert (killed / "robot.safetensors").read_bytes() == content
    [robots] = read_trained_run(whole).policies.values()
    assert (robots.spec.observation_size, robots.spec.latent) == (2, run.trainer.latent)
    policy, params = Policy(robots.spec), robots.row(1)
    shapes = jax.eval_shape(policy.init, jax.random.key(0))
    assert jax.tree.map(np.shape, params) == jax.tree.map(lambda leaf: leaf.shape, shapes)
    leaves = safetensors.numpy.load(content)
    assert {name.split("/")[0] for name in leaves} <= {*params}


def test_series_keeps_partner_wish_and_memory():
    """Within a series an episode's end is none for the robot, and its partner starts anew."""
    run, others = run_of("rl2", 1, series=3, num_envs=12, rollout_steps=12), partners()
    env = ToyEnv(match, episode_length=4)
    with pytest.raises(ValueError, match="rollout_steps is 12"):
        PPO(run.trainer, env, 1, others)
    run = run_of("rl2", 1, series=3, num_envs=12, rollout_steps=4, minibatches=1)
    trainer = PPO(run.trainer, env, 1, others)
    state = initial_state(run, trainer)
    collect = jax.jit(trainer.collect, compiler_options=FAST_COMPILE)
    for _ in range(4):
        turn, likes = state.simulations.series.turn, state.simulations.env.params.preference.force
        step = np.asarray(state.simulations.env.step)
        state, batch, _ = collect(state, others.params)
        more = np.asarray(turn) < 2
        ends = np.asarray(batch.truncated)
        assert not ends[:, more].any() and ends.sum(0)[~more].tolist() == [1] * (~more).sum()
        first = np.concatenate([np.asarray(batch.first)[1:], batch.last_first[None]])
        np.testing.assert_array_equal(first, ends)
        assert ends.argmax(0)[~more].tolist() == (3 - step)[~more].tolist()
        np.testing.assert_array_equal(state.simulations.series.turn, np.where(more, turn + 1, 0))
        kept = np.asarray(state.simulations.env.params.preference.force) == np.asarray(likes)
        assert kept[more].all() and not kept[~more].all()


def test_hidden_observation_of_networks_and_persons():
    env = WithHidden(Settings(), partners(), 8)
    humans = partners().humans(8)
    state = env.reset(jax.random.split(jax.random.key(0), 8), humans)
    assert env.observation_size[HIDDEN] == 3
    np.testing.assert_array_equal(state.obs[WHO][:, 0], [0, 0, 1, 1, 2, 2, 3, 3])
    np.testing.assert_array_equal(state.obs[HIDDEN][:, 0], humans.strength)
    after = env.step(state, {"robot": jnp.zeros((8, 1)), "human": jnp.zeros((8, 2))})
    np.testing.assert_array_equal(after.obs[HIDDEN], state.obs[HIDDEN])
    rows = persons("gentle_scratch")[numbers("training")[:50]]
    people = DrawnPersons(PersonPlayer("gentle_scratch"), jnp.asarray(marked(rows)), "some")
    env = WithHidden(Settings(), people, 8)
    met = people.renewed(people.humans(8), jax.random.split(jax.random.key(1), 8))
    state = env.reset(jax.random.split(jax.random.key(0), 8), met)
    np.testing.assert_array_equal(state.obs[WHO][:, 0], met.person)
    spread = (rows - rows.mean(0)) / rows.std(0)
    np.testing.assert_allclose(state.obs[HIDDEN][:, 3:], spread[met.person], atol=1e-4)


def test_old_specs_are_unchanged_and_latents_stored():
    old, new = PolicySpec("robot", 5, 2), PolicySpec("robot", 5, 2, latent=4)
    assert "latent" not in old.to_json() and old.digest == "56842c16"
    assert spec_from_json(new.to_json()) == new and new.digest != old.digest
    with pytest.raises(ValueError, match="latent is 4 and torso 'gru'"):
        PolicySpec("robot", 5, 2, torso="gru", latent=4)


@pytest.mark.parametrize(
    ("algorithm", "changes", "message"),
    [
        ("sarsa", {}, "algorithm is 'sarsa'; allowed are ppo, sac, dagger, gru, asymm"),
        ("ppo", {"method": "sarsa"}, "method is 'sarsa'; allowed are gru, asymmetric"),
        ("ppo", {"latent": 3}, "only a method trains a latent"),
        ("liam", {"torso": "gru"}, "only a method trains a latent"),
        ("ppo", {"series": 5}, "choose torso gru"),
        ("liam", {"beta": 1}, "unknown hyperparameter beta of liam"),
        ("rma", {"student_share": 1.0}, "student_share"),
    ],
)
def test_what_cannot_be_is_refused(algorithm, changes, message):
    with pytest.raises(ValueError, match=message):
        robot_preset(algorithm, **changes)


@pytest.mark.parametrize("name", NAMES)
def test_teams_have_no_method(name):
    config = robot_preset(name, **TINY)
    with pytest.raises(ValueError, match="give partners, or leave them out"):
        PPO(config, ToyEnv(match), 1)


def test_registered_method_has_a_preset():
    class Nothing(Method):
        """Adds nothing."""

    register("nothing", Nothing, latent=2)
    register("nothing", Nothing, latent=2)  # a notebook's cell that runs twice
    try:
        config = robot_preset("nothing", num_envs=8)
        assert isinstance(config, PPOConfig) and (config.method, config.latent) == ("nothing", 2)
        assert method_class("nothing") is Nothing and method_class("rl2") is Method
        with pytest.raises(ValueError, match="there is a method 'liam' already"):
            register("liam", Nothing)
    finally:
        del METHODS["nothing"]
