"""Environments made once a session, and rollouts that the tests of this folder share."""

import functools
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax_envs
from assistax_envs import Env, EnvState
from assistax_envs.physics import GIVES_CONTACT_FRAMES
from assistax_envs.registered import REGISTERED
from assistax_envs.versions import GENTLE_TASKS

BACKENDS = ("fused", "native", "mjx")
# A task of the paper and a gentle one, in every run; where the others differ in the scene alone,
# their tests are slow.
QUICK_TASKS = ("scratch", "gentle_lift")


def each_of(tasks: Iterable[str]) -> pytest.MarkDecorator:
    """Test each task; those that are not quick are slow."""
    return pytest.mark.parametrize(
        "task",
        [pytest.param(t, marks=() if t in QUICK_TASKS else pytest.mark.slow) for t in tasks],
    )


one_gentle_task = each_of(GENTLE_TASKS)


# MJX takes ten seconds or more to compile a scene.
native_and_mjx = pytest.mark.parametrize(
    "backend", ["native", pytest.param("mjx", marks=pytest.mark.slow)]
)


def backends(task: str, among: tuple[str, ...] = BACKENDS) -> list[str]:
    """Return the backends that play a task."""
    gives = GIVES_CONTACT_FRAMES if REGISTERED[task].felt else BACKENDS
    return [backend for backend in among if backend in gives]


@functools.cache
def environment(task: str, backend: str) -> Env:
    return assistax_envs.make(task, backend)


def seat(task: str) -> int:
    """Return how many torques the human of a task has."""
    return 5 if REGISTERED[task].seat == "mouth" else 3


@functools.cache
def compiled(task: str, backend: str):
    env = environment(task, backend)
    return jax.jit(env.reset), jax.jit(env.step)


def start(task: str, backend: str, settings: list[str], seed: int = 0) -> EnvState:
    keys = jax.random.split(jax.random.key(seed), len(settings))
    return compiled(task, backend)[0](keys, assistax_envs.disability_params(settings))


def random_actions(
    size: int, steps: int, seed: int = 0, human: int = 3
) -> list[dict[str, jax.Array]]:
    """Uniform actions from NumPy, the same on every platform; `human` joints in the seat."""
    rng = np.random.default_rng(seed)
    return [
        {
            role: jnp.asarray(rng.uniform(-1.0, 1.0, (size, width)), jnp.float32)
            for role, width in (("robot", 7), ("human", human))
        }
        for _ in range(steps)
    ]


def constant_actions(
    size: int, steps: int, robot: float, human: float, joints: int = 3
) -> list[dict[str, jax.Array]]:
    action = {"robot": jnp.full((size, 7), robot), "human": jnp.full((size, joints), human)}
    return [action] * steps


def play(
    task: str, backend: str, state: EnvState, actions: list[dict[str, jax.Array]]
) -> list[EnvState]:
    """Return the state after each action."""
    step = compiled(task, backend)[1]
    states = []
    for action in actions:
        state = step(state, action)
        states.append(state)
    return states
