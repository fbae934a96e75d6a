"""DAgger: a robot learns to act like one that is told, as far as it can know the wishes."""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs.persons import PersonPlayer, persons
from assistax_envs.persons.rows import marked
from assistax_envs.preferences import PREFERRED, WORDS
from evaluation.ego_training import EgoTraining, with_teachers
from population.config import MIXED, Member, TrainConfig
from population.environment import TEACHER, WithTeacher
from population.hyperparameters import DAggerConfig, robot_preset
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack
from population.partners.drawn_persons import DrawnPersons
from population.runs.folder import extends
from population.runs.train import initial_state, make_trainer, train
from population.runs.trained import read_trained_run
from tests.population.hidden_env import PARTNERS, HiddenBit, partners
from tests.population.test_ppo import FAST_COMPILE
from zoo.parameters.storage import write_policy_file

GENTLE = tuple(PREFERRED)
TINY: dict[str, Any] = {"num_envs": 8, "rollout_steps": 6, "minibatches": 2, "hidden": (8, 8)}


class ToldBit(HiddenBit):
    """The robot sees the bit in the second step alone; critics see it before words of silence."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_size = {"robot": 2 + len(WORDS), "human": 3, "global": 1 + len(WORDS)}

    def _observe(self, cue: Any, keys: Any, step: Any, shown: bool) -> dict[str, jax.Array]:
        obs = super()._observe(cue, keys, step, shown=True)
        silence = jnp.zeros((len(cue["human"]), len(WORDS)))
        robot = jnp.concatenate([obs["robot"][:, :2], silence], axis=1)
        seen = jnp.concatenate([cue["human"][:, None], silence], axis=1)
        return {"robot": robot, "human": obs["human"], "global": seen}


def teacher(count: int = 1, width: int = 3 + len(WORDS), place: int = 2) -> PolicyStack:
    """Return teachers that do half of the number at a place, which is the bit they are told."""
    spec = PolicySpec("robot", width, 1, hidden=(4,), normalise=False)
    tree = jax.tree.map(jnp.zeros_like, Policy(spec).init(jax.random.key(0)))
    tree["Dense_0"]["kernel"] = tree["Dense_0"]["kernel"].at[place, 0].set(2.0)
    tree["Dense_1"]["kernel"] = tree["Dense_1"]["kernel"].at[0].set(0.5 / np.tanh(2.0))
    stacked = jax.tree.map(lambda leaf: np.stack([np.asarray(leaf)] * count), tree)
    return PolicyStack(spec, tuple(map(str, range(count))), stacked)


def run_of(updates: int, members: int = 1, **changes: Any) -> TrainConfig:
    config = robot_preset("dagger", **{**TINY, "num_envs": 64, "learning_rate": 3e-3, **changes})
    team = tuple(Member(seed, MIXED) for seed in range(members))
    steps = config.batch_steps * updates
    return TrainConfig(
        "toy", "dagger", team, steps, config, partners=PARTNERS, self_play_episodes=0
    )


def learned(updates: int, *names: str, **changes: Any) -> list[float]:
    """Return metrics at the end of a run: by default the error, and the reward of a step."""
    run, others = run_of(updates, **changes), partners()
    trainer = make_trainer(run, ToldBit(), others, teacher())
    state, hyper = initial_state(run, trainer), trainer.hyper(run.members)
    step = lambda state, _: trainer.update(state, hyper, others.params)  # noqa: E731
    scan = partial(jax.lax.scan, step, length=updates)
    _, metrics = jax.jit(scan, compiler_options=FAST_COMPILE)(state)
    return [float(metrics[name][-5:].mean()) for name in names or ("imitation_error", "reward")]


def test_a_memory_imitates_all_but_what_cannot_be_known() -> None:
    """The bit shows in the second of twelve steps: what is left is the first, an error of 1/12.

    A robot without a memory knows the bit in one step of twelve.
    """
    error, reward = learned(60)
    assert error < 0.25 and reward > 0.75
    error, reward = learned(60, torso="mlp", hidden=(16,))
    assert error > 0.8 and reward < 0.25


def test_a_memory_learns_to_read_what_the_teacher_is_told() -> None:
    [read] = learned(60, "reading_error")
    [unread] = learned(60, "reading_error", aux_coef=0.0)
    assert read < 0.2 and unread > 0.9  # shares of the variance


def test_unknown_hyperparameters_and_rewards_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown hyperparameter gamma of dagger"):
        robot_preset("dagger", gamma=0.9)
    with pytest.raises(ValueError, match="choose num_envs as a multiple of minibatches"):
        robot_preset("dagger", num_envs=10, minibatches=4)
    config = robot_preset("dagger")
    assert isinstance(config, DAggerConfig) and config.torso == "gru"
    assert not extends(config) and extends(dataclasses.replace(config, anneal_lr=False))
    run = run_of(1)
    assert TrainConfig.from_json(run.to_json()) == run


def test_teachers_that_do_not_fit_are_refused() -> None:
    run, env, others = run_of(1, members=2), ToldBit(), partners()
    with pytest.raises(ValueError, match="give partners, and a teacher that observes"):
        make_trainer(run, env, others)
    with pytest.raises(ValueError, match="2 robots learn from 1 teachers"):
        make_trainer(run, env, others, teacher())
    with pytest.raises(ValueError, match="the teacher observes 10 numbers and a robot of toy 10"):
        make_trainer(run, env, others, teacher(2, width=10))
    blind = teacher(2)
    latent = dataclasses.replace(blind, spec=dataclasses.replace(blind.spec, latent=4))
    with pytest.raises(ValueError, match="the teacher has a latent of 4"):
        make_trainer(run, env, others, latent)
    ppo = dataclasses.replace(run, algorithm="ppo", trainer=robot_preset("ppo"))
    with pytest.raises(ValueError, match="algorithm 'ppo' learns from rewards; leave the teacher"):
        make_trainer(ppo, env, others, teacher(2))


def test_files_of_other_robots_are_no_teachers(tmp_path: Path) -> None:
    run = run_of(1, members=3)
    unread: Any = None
    training = EgoTraining(run, partners(), unread, unread, 64)
    stack, files = teacher(2), [tmp_path / "0.safetensors", tmp_path / "1.safetensors"]
    for row, file in enumerate(files):
        told = {"task": "toy", "told": True}
        params = jax.tree.map(lambda leaf, row=row: leaf * (1.0 + row), stack.row(row))
        write_policy_file(file, stack.spec, params, told)
    taught = with_teachers(training, files)
    assert taught.teacher is not None
    assert taught.teacher.ids == (str(files[0]), str(files[1]), str(files[0]))
    other = with_teachers(training, files[::-1])
    assert {taught.config.key["teacher"]} != {other.config.key["teacher"]}
    assert with_teachers(training, []) is training
    for metadata in ({"task": "toy"}, {"task": "other", "told": True}, {"task": "toy", "told": 1}):
        write_policy_file(files[1], stack.spec, stack.row(0), metadata)
        with pytest.raises(ValueError, match="is no robot of toy that is told the preference"):
            with_teachers(training, files)
    wide = dataclasses.replace(stack.spec, hidden=(4,), activation="relu")
    write_policy_file(files[1], wide, stack.row(0), {"task": "toy", "told": True})
    with pytest.raises(ValueError, match="have networks of different forms"):
        with_teachers(training, files)


@pytest.mark.parametrize("task", GENTLE)
def test_a_teacher_observes_what_a_told_robot_does(task: str) -> None:
    told = assistax_envs.make(task, "fused", told=("human", "robot"))
    plain = WithTeacher(assistax_envs.make(task, "fused"), told.observation_size["robot"])
    keys = jax.random.split(jax.random.key(1), 4)
    humans = DrawnPersons(PersonPlayer(task), jnp.asarray(marked(persons(task)[:4])), "all")
    params = humans.renewed(humans.humans(4), keys)
    states = [jax.jit(env.reset)(keys, params) for env in (plain, told)]
    action = {role: jnp.full((4, size), 0.3) for role, size in told.action_size.items()} | {
        "word": jnp.arange(4, dtype=jnp.int32)
    }
    for step in range(2):
        seen = [np.asarray(states[0].obs[TEACHER]), np.asarray(states[1].obs["robot"])]
        np.testing.assert_array_equal(*seen, err_msg=f"step {step}")
        assert states[0].obs["robot"].shape[1] == plain.observation_size["robot"] < seen[0].shape[1]
        states = [
            jax.jit(env.step)(state, action)
            for env, state in zip((plain, told), states, strict=True)
        ]


def test_a_run_has_a_robot_of_the_plain_form_and_stays_with_its_teacher(tmp_path: Path) -> None:
    run, env, others = run_of(2, num_envs=8), ToldBit(), partners()
    run = dataclasses.replace(run, key={"teacher": "a"})
    train(run, env, tmp_path, partners=others, teacher=teacher())
    robots = read_trained_run(tmp_path).policies["robot"]
    assert robots.spec.observation_size == env.observation_size["robot"]
    assert robots.spec.torso == "gru" and not (tmp_path / "checkpoints").exists()
    changed = dataclasses.replace(run, key={"teacher": "b"})
    with pytest.raises(ValueError, match=r"key.teacher is \"a\" there and \"b\" here"):
        train(changed, env, tmp_path, partners=others, teacher=teacher())
