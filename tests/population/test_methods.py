"""Methods beside PPO: each wins where its idea is needed, and loses nothing where it is not."""

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest

from population.config import MIXED, Member, TrainConfig
from population.hyperparameters import robot_preset
from population.runs.train import initial_state
from population.trainers.ppo import PPO
from tests.population.hidden_env import LENGTH, PARTNERS, HiddenBit, Settings, noisy, partners
from tests.population.test_ppo import FAST_COMPILE, SMALL
from tests.population.toy_env import ToyEnv

PROBE: dict[str, Any] = {**SMALL, "learning_rate": 3e-3, "num_envs": 64}


def learn(env, algorithm, updates, members=1, **changes):
    """Return the trainer, the state after some updates, and their metrics [U, M]."""
    config = robot_preset(algorithm, **{**PROBE, **changes})
    team = tuple(Member(seed, MIXED) for seed in range(members))
    steps = config.batch_steps * updates
    run = TrainConfig("toy", algorithm, team, steps, config, partners=PARTNERS)
    others = partners()
    trainer = PPO(config, env, updates, others)
    state, hyper = initial_state(run, trainer), trainer.hyper(run.members)
    step = lambda state, _: trainer.update(state, hyper, others.params)  # noqa: E731
    scan = partial(jax.lax.scan, step, length=updates)
    return trainer, *jax.jit(scan, compiler_options=FAST_COMPILE)(state)


def last(metrics, name, share=5):
    """Return the mean of a metric over the last updates in which it is a number."""
    values = np.asarray(metrics[name])
    return np.nanmean(values[-len(values) // share :])


def test_a_critic_that_knows_the_partner_is_not_confused_by_what_it_brings():
    """A partner brings up to 24 points a step that hide the robot's own 1 from PPO's critic."""
    earned = {
        name: last(learn(ToyEnv(noisy, episode_length=LENGTH), name, 60)[2], "term_own")
        for name in ("ppo", "asymmetric")
    }
    assert earned["asymmetric"] > max(0.5 * LENGTH, earned["ppo"] + 0.15 * LENGTH), earned


@pytest.mark.parametrize("name", ["liam", "palm"])
def test_a_memory_that_predicts_the_partner_remembers_its_bit(name):
    _, _, metrics = learn(HiddenBit(), name, 100, gamma=0.5)
    _, _, plain = learn(HiddenBit(), "ppo", 100, gamma=0.5)
    assert last(metrics, "return") > last(plain, "return") + 0.3 * LENGTH
    assert last(metrics, "model_loss_robot") < 0.4 < np.asarray(metrics["model_loss_robot"])[0]


def test_a_student_does_what_its_teacher_is_told():
    """The teacher is told the setting, which pays; the student sees it in the second step alone."""
    _, _, metrics = learn(Settings(), "rma", 100, gamma=0.5)
    _, _, plain = learn(Settings(), "ppo", 100, gamma=0.5)
    assert last(metrics, "return") > last(plain, "return") + 0.3 * LENGTH  # of the student
    assert last(metrics, "student_latent_error_robot") < 0.3
