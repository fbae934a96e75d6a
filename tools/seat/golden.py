"""Golden trajectories: what Python computes of a task, for a module to be held against."""

import base64
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs.own_settings import key_of, own_settings
from tools.seat.emitter import Place
from tools.seat.traces import TaskTraces, begun_tally, kept

STEPS = 1000


@own_settings()
def trajectory(
    traces: TaskTraces, params: Any, pointer: np.ndarray, words: np.ndarray, seed: int
) -> dict[str, np.ndarray]:
    """Return the words of memory [T, size] of each tree, as Python computes them.

    A visitor with a pointer [T, P] and words [T] plays with the robot of a network. "start" is the
    state before the first step.

    Args:
        traces: The functions of the task.
        params: Parameters of the robot.
        pointer: What the visitor points at at each step.
        words: Codes of words.
        seed: Seed of the start.
    """
    run = {one.name: one.run for one in traces.functions()}
    start, body, tally = begun(traces, seed)
    carry = traces.policy.initial_carry((1,))

    def step(at: Any, now: Any) -> tuple[Any, Any]:
        state, body, carry, first, tally = at
        point, word = now
        body, human = run["visitor"](body, state, point[None])
        carry, robot = run["network"](params, carry, state, first)
        rows = {"body": body, "human": human, "carry": carry, "robot": robot}
        rows["script"] = run["script"](state)
        if "told" in run:
            rows["told"] = run["told"](state)
        state, tally = run["step"](state, robot, human, word[None], tally)
        rows |= {"state": state, "tally": tally, "view": run["view"](state, body)[0]}
        return (state, body, carry, jnp.zeros(1, bool), tally), rows

    play = jax.jit(lambda begin, inputs: jax.lax.scan(step, begin, inputs)[1])
    inputs = jnp.asarray(pointer, jnp.float32), jnp.asarray(words, jnp.int32)
    made = play((start, body, carry, jnp.ones(1, bool), tally), inputs)
    return {name: _words(tree, len(words)) for name, tree in made.items()} | {
        "start": _words(start, 1)
    }


@functools.partial(jax.jit, static_argnums=0)
@own_settings()
def _begun(traces: TaskTraces, key: jax.Array) -> Any:
    state = traces.env.reset(key, traces.humans)
    return kept(state), traces.visitor.initial(state.obs["human"]), begun_tally(state)


def begun(traces: TaskTraces, seed: int) -> Any:
    """Return the state at the start of a seed, the visitor's body and the tally."""
    return _begun(traces, key_of(np.array([seed])))


def memory_of(tree: Any) -> np.ndarray:
    """Return the words of a tree of arrays with axis N of length 1, as a module holds them."""
    return _words(tree, 1)[0]


def packed(words: np.ndarray) -> str:
    """Return words as base64."""
    return base64.b64encode(np.ascontiguousarray(words).tobytes()).decode()


def places(traces: TaskTraces, name: str) -> list[Place]:
    """Return the leaves of a tree in the module's memory."""
    return traces.layout.trees[name][0]


def _words(tree: Any, rows: int) -> np.ndarray:
    """Return the leaves [rows, ...] side by side, each as four-byte words."""
    columns = []
    for leaf in jax.tree.leaves(tree):
        array = np.asarray(leaf)
        kind = np.float32 if array.dtype == np.float32 else np.int32
        columns.append(array.astype(kind).reshape(rows, -1).view(np.uint32))
    return np.concatenate(columns, axis=1)
