"""The front door's environments for training: whom they seat, and whom they refuse."""

import re
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_zoo as az
from assistax_base.errors import SplitError
from assistax_envs.persons.rows import side
from tests.untrained import gentle_specs, published, teams_of
from zoo.parameters import storage
from zoo.registry import load_registry
from zoo.splitting.create import create_split

TASK, TEAM = "scratch", "scratch/ippo-d1-s1-v1"


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 3)


def test_the_test_half_is_refused_and_never_read(monkeypatch: pytest.MonkeyPatch) -> None:
    read, load_shards = [], storage.load_shards

    def noted(registry, entries):
        read.extend(entry.team for entry in entries)
        return load_shards(registry, entries)

    monkeypatch.setattr("zoo.parameters.storage.load_shards", noted)
    split = load_registry().split(TASK)
    env = az.vector_env(TASK, 2, backend="native")
    assert set(read) == set(split.train) and not {*read} & {*split.test}
    env.reset(seed=0)
    assert {name.removesuffix("/human") for name in env.partner_names()} <= set(split.train)
    for name in (split.test[0], f"{split.test[0]}/human", [split.train[0], split.test[0]]):
        with pytest.raises(SplitError, match=f"of the training side of {split.id}.*its test side"):
            az.vector_env(TASK, 2, partners=name, backend="native")
    with pytest.raises(SplitError, match="found none there"):
        az.vector_env(TASK, 2, partners="scratch/nobody-*", backend="native")
    assert not {*read} & {*split.test}


@pytest.mark.slow
def test_partners_act_as_the_zoo_has_them() -> None:
    split = load_registry().split(TASK)
    names = split.train[:2]
    env = az.vector_env(TASK, 2, partners=names, form="jaxmarl", backend="native")
    both = az.vector_env(TASK, 2, partners=names, backend="native")
    _, state = jax.jit(env.reset)(jax.random.key(0))
    seated = [f"{name}/human" for name in names]
    partners = [az.open_zoo().partner(name) for name in seated]
    robot = jnp.full((2, 7), 0.3)
    for _ in range(2):
        human = np.asarray(state.env.obs["human"])
        _, after, *_ = jax.jit(env.step)(jax.random.key(1), state, {"robot": robot})
        errors = []
        for order in (partners, partners[::-1]):
            actions = jnp.asarray([one.act(seen) for one, seen in zip(order, human, strict=True)])
            played = jax.jit(env.batch.env.step)(state.env, {"robot": robot, "human": actions})
            errors.append(float(jnp.abs(played.obs["human"] - after.env.obs["human"]).max()))
        assert min(errors) < 1e-5 < max(errors)
        state = after
    both.reset(seed=0)
    first = both.partner_names()
    for _ in range(3):
        both.step(np.zeros((2, 7)))
    assert both.partner_names() == first[::-1] and set(first) == set(seated)


def test_split_gives_preferences_of_its_training_half(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Humans that nobody trained act alike.
    monkeypatch.setattr("zoo.splitting.create.similar_pairs", lambda registry, split: [])
    task = "gentle_scratch"
    path = published(teams_of(2, *gentle_specs(task), task=task), tmp_path)
    held_out = ["p1", "p5", "p9"]
    split = create_split(path, task=task, test_preferences=held_out, default=True)
    env = az.vector_env(task, 8, form="jaxmarl", backend="native", zoo=path)
    _, state = jax.jit(env.reset)(jax.random.key(0))
    allowed = split.preferences["train"]
    assert not {*allowed} & {*held_out}
    assert codes(state) <= {int(preference[1:]) for preference in allowed}


def codes(state: Any) -> set[int]:
    """Return the preferences of a state's humans."""
    return set(np.asarray(state.env.params.preference_code).tolist())


def test_preferences_may_be_a_text(tmp_path: Path) -> None:
    task = "gentle_scratch"
    path = published(teams_of(2, *gentle_specs(task), task=task), tmp_path)
    options: dict[str, Any] = {"form": "jaxmarl", "backend": "native", "zoo": path}
    env = az.vector_env(task, 8, preferences="p2,p7", **options)
    _, state = jax.jit(env.reset)(jax.random.key(0))
    assert codes(state) == {2, 7}


def test_a_gentle_task_has_persons_by_default() -> None:
    seated = {}
    for partners in (None, "gentle_scratch/person-0004*-v1"):
        env = az.vector_env("gentle_scratch", 2, partners=partners, backend="native")
        env.reset(seed=0)
        seated[partners] = [
            int(name.removeprefix("gentle_scratch/person-")) for name in env.partner_names()
        ]
    assert {side(number) for numbers in seated.values() for number in numbers} == {"training"}
    assert {number // 10 for number in seated["gentle_scratch/person-0004*-v1"]} == {4}
    for partners in ("gentle_scratch/person-09000-v1", "gentle_scratch/person-20000-v1"):
        with pytest.raises(SplitError, match="one of its test side"):
            az.vector_env("gentle_scratch", 2, partners=partners, backend="native")
    with pytest.raises(ValueError, match="persons have no preferences to choose"):
        az.vector_env("gentle_scratch", 2, preferences="p1", backend="native")


def test_forms_and_wrong_arguments() -> None:
    pettingzoo = az.vector_env(TASK, 2, partners=TEAM, form="pettingzoo", backend="native")
    obs, _ = pettingzoo.reset(seed=0)
    assert list(obs) == ["robot"] and obs["robot"].shape == (2, 34)
    with pytest.raises(ValueError, match="form is 'rllib'; allowed are gymnasium, sb3"):
        az.vector_env(TASK, form="rllib")
    with pytest.raises(ValueError, match="preference is 'p0'; allowed are p1"):
        az.vector_env(TASK, preferences=("p0",))
    with pytest.raises(ValueError, match="persons have no split and no preferences"):
        az.vector_env("gentle_scratch", partners="persons", preferences=("p1",))
    with pytest.raises(ValueError, match="no partner is named"):
        az.vector_env(TASK, partners=())
    with pytest.raises(ValueError, match=re.escape("arrays is 'jax', but form 'sb3'")):
        az.vector_env(TASK, form="sb3", arrays="jax")


def test_persons_are_of_gentle_tasks_alone() -> None:
    with pytest.raises(SplitError, match="a task with persons"):
        az.vector_env("scratch", 2, partners="persons", backend="native")
    with pytest.raises(SplitError, match=r"expected one split \(persons\)"):
        az.vector_env("gentle_scratch", 2, split="half", backend="native")
