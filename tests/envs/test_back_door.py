"""No back door: robots observe wishes through the human's body and words alone."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs import Env, EnvState
from assistax_envs.persons.player import PersonPlayer, person_params
from assistax_envs.persons.rows import marked, persons
from assistax_envs.preferences import PREFERRED, WORDS
from assistax_envs.tasks.chain import script_of
from assistax_envs.tasks.gentle_scratch.task import GentleScratch, StrokeState
from assistax_envs.versions import GENTLE_TASKS
from tests.envs.conftest import environment

N, EPISODE = 16, 1000
Actions = dict[str, jax.Array]  # [T, N, ...]


@functools.cache
def recorded(task: str, steps: int = EPISODE) -> tuple[Any, Actions]:
    """Return the humans of persons [N], and all actions of the script's episode with them."""
    env, player = environment(task, "fused"), PersonPlayer(task)
    script, rows = script_of(task, env.model), jnp.asarray(marked(persons(task)[:N]))
    params = person_params(task, rows)

    def step(loop: tuple[EnvState, Any], time: jax.Array) -> tuple[Any, Actions]:
        state, mind = loop
        mind, human = player.act({"row": rows}, mind, state.obs["human"], time == 0)
        robot = script(state.obs["robot"])
        action = {"robot": robot, "human": human, "word": player.word(mind)}
        return (env.step(state, action), mind), action

    def play(keys: jax.Array) -> Actions:
        begun = env.reset(keys, params), player.initial_carry((N,))
        return jax.lax.scan(step, begun, jnp.arange(steps))[1]

    return params, jax.jit(play)(jax.random.split(jax.random.key(6), N))


def replayed(env: Env, params: Any, actions: Actions) -> EnvState:
    """Return all states [T, N, ...] of the recorded actions with humans of other wishes."""

    def step(state: EnvState, action: Actions) -> tuple[EnvState, EnvState]:
        after = env.step(state, action)
        slim = dataclasses.replace(after, key=after.step, params=None)
        return after, slim

    def play(params: Any) -> EnvState:
        keys = jax.random.split(jax.random.key(6), N)
        return jax.lax.scan(step, env.reset(keys, params), actions)[1]

    return jax.jit(play)(params)


def with_other_wishes(params: Any) -> Any:
    """Return the same bodies with everybody's wishes and tolerance another's."""
    other = jax.tree.map(lambda wish: jnp.roll(wish, 1), params.preference)
    return dataclasses.replace(params, preference=other)


def progress(task: str, state: Any) -> np.ndarray:
    """Return what was done of the task by the end [N], such as strokes, whether liked or not."""
    done = {
        "gentle_scratch": lambda s: s.strokes,
        "gentle_bath": lambda s: (s.left == 0.0).sum(axis=-1),
        "gentle_feeding": lambda s: s.bites,
        "gentle_brushing": lambda s: s.done,
        "gentle_lift": lambda s: s.care.judged[..., 0].cumsum(axis=0),
    }
    return np.asarray(done[task](state))[-1]


def with_both_wishes(env: Env, steps: int = EPISODE) -> tuple[EnvState, EnvState]:
    """Return the states of the same actions with the persons' wishes, and with others."""
    params, actions = recorded(env.task, steps)
    return replayed(env, params, actions), replayed(env, with_other_wishes(params), actions)


def _of(task: str, backend: str) -> Any:
    quick = (task, backend) == ("gentle_scratch", "fused")
    return pytest.param(task, backend, marks=() if quick else pytest.mark.slow)


@pytest.mark.parametrize(
    ("task", "backend"), [_of(task, name) for task in GENTLE_TASKS for name in ("fused", "native")]
)
def test_robot_observes_no_wish_but_through_body_and_words(task: str, backend: str) -> None:
    first, other = both = with_both_wishes(environment(task, backend))
    np.testing.assert_array_equal(first.obs["robot"], other.obs["robot"])
    np.testing.assert_array_equal(first.terminated, other.terminated)
    # The episodes had what could tell: work that was done, liked by one and not by the other, and
    # words. The human and the reward know the wish.
    did = progress(task, first.task) > 0
    assert did.sum() >= N // 4
    assert len(np.unique(recorded(task)[1]["word"])) > 2
    differs = (np.asarray(first.reward) != np.asarray(other.reward)).any(axis=0)
    assert differs[did].mean() > 0.5  # what neither likes at all pays 0 to the last bit
    told, untold = (np.asarray(seen.obs["human"])[..., -len(PREFERRED[task]) :] for seen in both)
    assert (told != untold).all()
    np.testing.assert_array_equal(
        first.obs["robot"][..., -len(WORDS) :].sum(axis=-1), np.asarray(first.heard) > 0
    )


class Leaking(GentleScratch):
    """Counts the strokes that were liked alone, and shows them to the robot."""

    def transition(self, task_state: StrokeState, readings: Any) -> Any:
        after, *rest = super().transition(task_state, readings)
        return dataclasses.replace(after, strokes=after.well), *rest


def test_planted_back_door_is_seen() -> None:
    first, other = with_both_wishes(assistax_envs.make(Leaking, "fused"))
    apart = np.asarray(first.obs["robot"] != other.obs["robot"]).any(axis=(0, 1))
    assert np.flatnonzero(apart).tolist() == [len(apart) - len(WORDS) - 1]
