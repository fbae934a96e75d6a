"""Recorded actions played again from their starts, many episodes of a task at once.

The fused engine's CPU program gives the same bits as its program on the page. So the physics of an
episode that was recorded there is that of the page, and rewards follow from it.
"""

import dataclasses
import functools
import json
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from assistax_envs import Env, EnvParams, disability_params, make
from assistax_envs.own_settings import LANES, key_of, own_settings
from assistax_envs.preferences import VALUES, Preference
from assistax_envs.tasks.gentle_base import Preferences
from evaluation.people.log import STARTS, STEPS, Recorded
from evaluation.seat.modules import read_module
from population.play.programs import step_alone, trip_count
from population.play.tally import Tally, accumulate, begin, begin_window

ENGINE = "fused"  # the one engine that the page has too
BODY = "d1"  # without impairment: the page's program gives the visitor's arm its strength
AT_ONCE = LANES  # episodes of one call; a single program is compiled for all


@dataclasses.dataclass(frozen=True, eq=False)
class Played:
    """Episodes that were played again: N logs of T steps."""

    tally: Tally  # leaves [N]
    seen: np.ndarray  # [T, N, O] what the robot observed before each step
    ended: np.ndarray  # [N] bool: the log's last step was the episode's
    steps: dict[str, np.ndarray]  # what each step gave, [T, N, ...]; see `_given`

    def of(self, place: int) -> "dict[str, np.ndarray]":
        """Return the arrays [T, ...] of one episode's steps up to its end."""
        count = int(self.tally.steps[place])
        return {name: values[:count, place] for name, values in self.steps.items()}


def play(logs: Sequence[Recorded]) -> Played:
    """Return the episodes of logs of one task, played again in their order.

    Raises:
        ValueError: The logs are of several tasks, or there is none, or more than `AT_ONCE`.
    """
    tasks = sorted({recorded.log.task for recorded in logs})
    if len(tasks) != 1:
        raise ValueError(f"logs are of {', '.join(tasks) or 'no task'}; play those of one task")
    if len(logs) > AT_ONCE:
        raise ValueError(f"there are {len(logs)} logs; play at most {AT_ONCE} at once")
    return Played(*_part(tasks[0], logs))


def visitors(task: str, wishes: Sequence[dict[str, float]]) -> EnvParams:
    """Return the humans [N] of visitors: bodies without impairment, and the visitors' wishes.

    Args:
        task: The task.
        wishes: Values of each visitor by the names of the task's wishes.
    """
    middle = {name: values[1] for name, values in VALUES.items()}
    rows = [dataclasses.astuple(Preference(**middle | wish)) for wish in wishes]
    columns = jnp.asarray(np.array(rows, np.float32))
    body = disability_params([BODY] * len(wishes))
    return dataclasses.replace(body, preference=Preferences(*jnp.moveaxis(columns, -1, 0)))


@functools.cache
def environment(task: str) -> Env:
    """Return the environment of a task on the page's engine."""
    return make(task, ENGINE)


def drawn(task: str, starts: Sequence[int]) -> tuple[jax.Array, np.ndarray]:
    """Return the keys [N] of starts and the joint positions [N, nq] that they draw, rad.

    The positions are those of the page's file, because XLA's programs may round them differently
    in the last bit, which contacts amplify.
    """
    table, layout = _starts(task)
    offset, size, _ = layout[".physics.qpos"]
    qpos = np.ascontiguousarray(table[list(starts), offset : offset + size]).view("<f4")
    return key_of(np.array(starts, np.uint32)), qpos.astype(np.float32)


def begun(env: Env, keys: jax.Array, qpos: jax.Array | np.ndarray, humans: EnvParams) -> Any:
    """Return the state [N] in which episodes of drawn starts begin."""
    state = env.reset(keys, humans)
    return env.begin(jnp.asarray(qpos), state.task, state.key, humans)


@functools.cache
def _starts(task: str) -> tuple[np.ndarray, dict[str, list[Any]]]:
    """Return the words of a task's starts, a row each, and the places of a state's leaves."""
    parts = read_module(task)
    table = np.frombuffer(parts["starts"], "<u4").reshape(STARTS, -1)
    return table, json.loads(parts["layout"])["memory"]["state"]


@own_settings()
def _part(task: str, logs: Sequence[Recorded]) -> tuple[Tally, np.ndarray, np.ndarray, Any]:
    """Return the parts of `Played` of at most `AT_ONCE` logs: the last one fills the batch."""
    filled = [*logs, *[logs[-1]] * (AT_ONCE - len(logs))]
    starts = [recorded.log.start for recorded in filled]
    actions = {
        "robot": _padded([recorded.robot for recorded in filled]),
        "human": _padded([recorded.human for recorded in filled]),
        "word": _padded([recorded.words.astype(np.int32) for recorded in filled]),
    }
    humans = visitors(task, [recorded.log.wish for recorded in filled])
    played = _program(task)(*drawn(task, starts), humans, actions, trip_count())
    tally, (seen, given) = played
    last = np.array([recorded.log.steps for recorded in filled])
    ended = np.asarray(tally.steps == last) & (last == STEPS)
    stops = np.asarray(given["terminated"])[last - 1, np.arange(len(filled))]
    ended |= np.asarray(tally.steps == last) & stops
    count = len(logs)
    return (
        jax.tree.map(lambda leaf: np.asarray(leaf)[:count], tally),
        np.asarray(seen)[:, :count],
        ended[:count],
        {name: np.asarray(values)[:, :count] for name, values in given.items()},
    )


def _padded(rows: Sequence[np.ndarray]) -> jax.Array:
    """Return arrays [t, ...] as one [STEPS, N, ...]; steps after the end of one are zero."""
    whole = np.zeros((STEPS, len(rows), *rows[0].shape[1:]), rows[0].dtype)
    for place, row in enumerate(rows):
        whole[: len(row), place] = row
    return jnp.asarray(whole)


@functools.cache
def _program(task: str) -> Callable[..., Any]:
    """Return the compiled program that plays recorded actions of a task."""
    env = environment(task)

    def step(trips: Any, loop: tuple[Any, ...], now: tuple[Any, ...]) -> tuple[Any, Any]:
        state, tally, window = loop
        time, actions = now
        after = step_alone(env, state, actions, trips)
        angles = [env.joint_positions(one) for one in (state, after)]
        moved = {role: jnp.abs(angles[1][role] - angles[0][role]) for role in angles[0]}
        travel = {role: by.sum(axis=-1) for role, by in moved.items()}
        window = window.at[time % len(window)].set(after.measures.force)
        tally = accumulate(tally, state, after, travel, window, time)
        return (after, tally, window), (state.obs["robot"], _given(after, travel["human"]))

    @jax.jit
    def program(keys: Any, qpos: Any, humans: Any, actions: Any, trips: Any) -> tuple[Tally, Any]:
        state = begun(env, keys, qpos, humans)
        loop = state, begin(state, env.joint_positions(state)), begin_window(state)
        (_, tally, _), given = jax.lax.scan(
            functools.partial(step, trips), loop, (jnp.arange(STEPS), actions)
        )
        return tally, given

    return program


def _given(state: Any, moved: Float[Array, "*N"]) -> dict[str, jax.Array]:
    """Return the arrays [N, ...] of a step; `moved` is the way of the human's joints, rad."""
    measures = state.measures
    return {
        "reward": state.reward,
        "terminated": state.terminated,
        "force": measures.force,
        "felt": measures.felt,
        "done": measures.done,
        "judged": measures.judged,
        "liked": measures.liked,
        "moved": moved,
        "qpos": state.physics.qpos,
    }
