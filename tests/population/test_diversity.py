import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from assistax_workshop.plans.plan import Group, planned_runs
from assistax_workshop.sweep import Sweep
from assistax_workshop.sweep_space import Range
from population.config import Member, TrainConfig, make_members, make_run, populations
from population.hyperparameters import preset
from population.methods import diversity
from population.methods.diversity import log_mean_density
from population.runs.train import train
from population.trainers import experience
from tests.population.test_ppo import FAST_COMPILE, SMALL, assert_same, networks, run, start
from tests.population.toy_env import ToyEnv, match
from tests.workshop.test_plan import begin, finish, labels

MEP = preset("mep", **SMALL)
PAIR = make_members([0, 1], ["d1"])


def slow_log_mean_density(mean, log_std, raw):
    """log (1/n) sum_j prod_k N(raw_k; mean_jk, std_jk), in double precision."""
    mean, std = np.stack(mean), np.exp(np.stack(log_std))
    densities = np.exp(-0.5 * ((raw - mean) / std) ** 2) / (std * math.sqrt(2.0 * math.pi))
    return np.log(densities.prod(-1).mean(0))


def rollout(members, config=MEP):
    """Return a trainer, its state before a rollout, the rollout, and the hyperparameters."""
    ppo, state, hyper = start(ToyEnv(match), config, members)
    after, batch, keys = jax.jit(ppo.collect, compiler_options=FAST_COMPILE)(state)
    return ppo, after, experience.by_member(batch, len(keys)), hyper


def usual(ppo, state, batch, peers):
    params = ppo.policy_params(state.members)["human"]
    return log_mean_density(ppo.policies["human"], params, peers, batch)


@pytest.mark.parametrize("platform", ["cpu", "gpu"])
def test_mean_density_ignores_other_populations(platform, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: platform)
    members = (Member(0, "d1"), Member(0, "d9"), Member(1, "d1"), Member(1, "d9"))
    ppo, state, batch, hyper = rollout(members)
    divergence = usual(ppo, state, batch, hyper["peers"])
    params = ppo.policy_params(state.members)["human"]
    for member, population in enumerate([(0, 2), (1, 3), (0, 2), (1, 3)]):
        obs, raw = batch.obs["human"][member], np.asarray(batch.raw["human"][member], float)
        gaussians = [
            ppo.policies["human"].step(
                jax.tree.map(lambda leaf, j=j: leaf[j], params), (), obs, batch.first[member]
            )[1]
            for j in population
        ]
        mean, log_std = (
            [np.broadcast_to(getattr(g, name), raw.shape).astype(float) for g in gaussians]
            for name in ("mean", "log_std")
        )
        expected = slow_log_mean_density(mean, log_std, raw)
        np.testing.assert_allclose(divergence[member], expected, rtol=1e-4, atol=1e-4)
    everyone = usual(ppo, state, batch, jnp.tile(jnp.arange(4), (4, 1)))
    # Planted: neighbours of another setting.
    assert np.abs(everyone - divergence).max() > 1e-3


def test_tiny_densities_stay_distinct():
    """A mean of densities, and not of their logarithms, would be log 0 for rare actions."""
    ppo, state, batch, hyper = rollout(PAIR)
    far = dataclasses.replace(batch, raw={**batch.raw, "human": batch.raw["human"] + 100.0})
    divergence = usual(ppo, state, far, hyper["peers"])
    assert np.isfinite(divergence).all() and (divergence < -1000.0).all()


def with_bonus(ppo, members, batch, hyper):
    params = ppo.policy_params(members)["human"]
    return diversity.with_bonus(ppo.policies["human"], params, batch, hyper)


def test_bonus_of_equal_humans_is_their_entropy():
    ppo, state, batch, hyper = rollout(PAIR)
    alike, first = jax.tree.map(lambda leaf: jnp.stack([leaf[0]] * 2), (state.members, batch))
    # The bonus by itself, before training mixes it with the rest.
    paid, logged = with_bonus(ppo, alike, first, hyper)
    coefficient = hyper["population_coef"][:, None, None]
    own = first.reward - coefficient * first.log_prob["human"]
    np.testing.assert_allclose(paid.reward, own, atol=1e-6)
    np.testing.assert_allclose(logged["population_divergence"], 0.0, atol=1e-5)
    actor = alike.learners["human"].networks["actor"]
    bias = actor["Dense_2"]["bias"]
    actor["Dense_2"]["bias"] = bias.at[1].add(1.0)
    _, logged = with_bonus(ppo, alike, first, hyper)
    assert 0.1 < logged["population_divergence"][0] <= math.log(2)


@pytest.mark.slow
def test_without_bonus_mep_equals_ippo():
    _, ippo, _ = run(ToyEnv(match), preset("ippo", **SMALL), PAIR, updates=3)
    _, mep, metrics = run(ToyEnv(match), preset("mep", **SMALL, population_coef=0), PAIR, updates=3)
    assert_same(networks(mep), networks(ippo))
    assert "population_entropy" not in metrics
    _, mep, _ = run(ToyEnv(match), MEP, PAIR, updates=3)
    with pytest.raises(AssertionError):
        assert_same(networks(mep), networks(ippo))


def test_bonus_is_annealed_and_not_in_the_return():
    config = dataclasses.replace(MEP, population_coef=10.0, anneal_entropy=True)
    ppo, state, hyper = start(ToyEnv(match), config, PAIR, updates=4)
    update = jax.jit(ppo.update, compiler_options=FAST_COMPILE)
    last = dataclasses.replace(state, update=jnp.asarray(4, jnp.int32))
    after, metrics = update(last, hyper)
    none = {**hyper, "population_coef": jnp.zeros(2)}
    without, expected = update(last, none)
    assert_same(networks(after), networks(without))
    assert np.abs(metrics["reward"]).max() <= 1.0
    _, paid = update(state, hyper)
    np.testing.assert_array_equal(paid["reward"], expected["reward"])
    assert np.abs(paid["value_loss_human"]).min() > 10.0 * expected["value_loss_human"].max()


@pytest.mark.slow
def test_bonus_makes_humans_differ_in_free_actions():
    """The human's second action has no effect; without the bonus no two differ in it."""
    spread = {}
    for weight in (1e-9, 0.1):
        config = dataclasses.replace(MEP, population_coef=weight, entropy_coef=0.0)
        _, _, metrics = run(ToyEnv(match), config, PAIR, updates=60)
        spread[weight] = float(metrics["population_divergence"][-5:].mean())
    assert spread[0.1] > 2.0 * spread[1e-9]


def test_population_differs_in_seed_alone():
    members = (*make_members([0, 1], ["d1", "d3"]), Member(5, "d1", {"gamma": 0.9}))
    assert populations(members) == [[0, 1], [2, 3], [4]]
    assert diversity.peers(members[:4]).tolist() == [[0, 1], [0, 1], [2, 3], [2, 3]]
    sweep = Sweep("toy", "mep", {"gamma": Range(0.8, 0.9)}, 3, 2, block=6, steps=64)
    [(_, config)] = sweep.blocks()
    assert populations(config.members) == [[0, 1], [2, 3], [4, 5]]


@pytest.mark.parametrize(
    ("members", "changes", "message"),
    [
        (make_members([0], ["d1", "d3"]), {}, r"has populations of \[1\]; give every setting"),
        ((*PAIR, Member(0, "d3")), {}, r"has populations of \[1, 2\]; give every setting"),
        (PAIR, {"partners": ("a",)}, "an ego's partners are frozen; set it to 0"),
        ((Member(0, "d1", {"population_coef": 0.1}),), {"trainer": preset("ippo")}, "it is 0 in"),
    ],
)
def test_invalid_population_is_refused(members, changes, message):
    with pytest.raises(ValueError, match=message):
        TrainConfig("toy", "mep", members, 640, **{"trainer": MEP, **changes})


@pytest.mark.parametrize("changes", [{"torso": "gru"}, {"shared": True}])
def test_population_refuses_recurrent_and_shared_networks(changes):
    with pytest.raises(ValueError, match=r"population_coef is 0\.01 with .* leave shared"):
        preset("mep", **changes)


GROUP = {
    "name": "scratch-mep", "task": "scratch", "algorithm": "mep", "steps": 1000,
    "disabilities": ["d1", "d3"], "seeds": 3,
}  # fmt: skip


def test_a_plan_never_cuts_a_population(tmp_path):
    group = Group(**GROUP, max_members=5)
    assert labels(planned_runs(group, tmp_path)) == {
        "scratch-mep": ("new", ["d1-s0", "d1-s1", "d1-s2"]),
        "scratch-mep-2": ("new", ["d3-s0", "d3-s1", "d3-s2"]),
    }
    with pytest.raises(ValueError, match="max_members is 2; the 3 seeds of a setting are one"):
        Group(**GROUP, max_members=2)


def test_plan_adds_settings_but_no_seeds_to_populations(tmp_path):
    group = Group(**GROUP)
    begin(group, tmp_path / "scratch-mep", group.members)
    wider = Group(**{**GROUP, "disabilities": ["d1", "d3", "d5"]})
    names = [block.name for block in planned_runs(wider, tmp_path)]
    assert names == ["scratch-mep", "scratch-mep-2"]
    more = Group(**{**GROUP, "seeds": 5})
    with pytest.raises(ValueError, match="lacks 2 of its 5 teams of d1"):
        planned_runs(more, tmp_path)
    published = {("d1", 0), ("d1", 1)}
    with pytest.raises(ValueError, match="lacks 1 of its 3 teams of d1"):
        planned_runs(group, tmp_path / "elsewhere", published)
    finish(tmp_path / "other" / "scratch-mep", group.members, algorithm="mep")
    [block] = planned_runs(group, tmp_path / "other")
    assert block.state == "finished"


@pytest.mark.parametrize(("weight", "shares"), [(0.0, 2), (0.1, 1)])
def test_a_population_stays_on_one_device(weight, shares, tmp_path, monkeypatch):
    def count(members, devices):
        raise InterruptedError(members)

    monkeypatch.setattr("population.runs.train.DeviceShares", count)
    trainer = dataclasses.replace(MEP, population_coef=weight)
    config = make_run("toy", "mep", PAIR, 320, trainer)
    with pytest.raises(InterruptedError, match=str(shares)):
        train(config, ToyEnv(match), tmp_path / "run")
