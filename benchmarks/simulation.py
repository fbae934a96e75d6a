"""Speed of simulation: the raw environment, and the evaluator. Compilation is not counted."""

import dataclasses
import functools
import os
import statistics
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax_envs import DISABILITY_SETTINGS, disability_params
from assistax_envs.persons import PersonPlayer, person_params, persons
from assistax_envs.persons.rows import marked
from benchmarks.timing import REPEATS, calls_within, timed
from evaluation.cast.roster import Member, Roster
from evaluation.play.jobs import Job
from evaluation.play.runner import Runner
from evaluation.play.tiles import plan
from population.networks.policy import Policy
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack

CALL = 10  # steps in one program


@dataclasses.dataclass(frozen=True)
class EnvSpeed:
    """Speed of random actions in one backend at one batch size."""

    task: str
    backend: str
    batch: int
    human: str  # "random" actions, or those of "persons"
    env_steps_per_second: float  # median of the repeats
    repeats: tuple[float, ...]
    steps: int  # of every simulation, in each repeat
    compile_seconds: float  # not counted
    device: str


@dataclasses.dataclass(frozen=True)
class EvaluatorSpeed:
    """Speed of the evaluator and of the raw environment, in turns, with as many simulations."""

    task: str
    backend: str
    egos: int
    partners: int
    episodes: int
    env_steps_per_second: float  # of the evaluator, median
    pairs_per_second: float  # of whole episodes, all of a pair's
    raw_env_steps_per_second: float
    ratio: float  # median of the ratios of neighbouring runs
    device: str


def measure_env(env: Any, batch: int, seconds: float = 3.0, persons: bool = False) -> EnvSpeed:
    """Return the env steps/s of uniform random actions, with disability settings mixed.

    With `persons` the human's seat is that of the first rows of the task's persons.
    """
    began = time.perf_counter()
    run = open_loop(env, batch, Persons(env.task, batch) if persons else None)
    jax.block_until_ready(run(1))
    compile_seconds = time.perf_counter() - began
    calls = _calls(env, run, seconds)
    speeds = [calls * CALL * batch / timed(run, calls) for _ in range(REPEATS)]
    return EnvSpeed(
        task=env.task,
        backend=env.backend,
        batch=batch,
        human="persons" if persons else "random",
        env_steps_per_second=statistics.median(speeds),
        repeats=tuple(speeds),
        steps=calls * CALL,
        compile_seconds=compile_seconds,
        device=device_name(env.backend),
    )


def measure_evaluator(
    env: Any, shape: tuple[int, int, int], seconds: float = 3.0
) -> EvaluatorSpeed:
    """Return the speed of the evaluator and of the raw environment.

    Policies are untrained: E x P pairs, K episodes. The evaluator cuts the job as it would any
    other; the environment steps all simulations at once.
    """
    egos, partners, episodes = shape
    simulations = egos * partners * episodes
    run = open_loop(env, simulations)
    jax.block_until_ready(run(1))
    steps = _calls(env, run, seconds) * CALL
    job = _untrained_job(env, shape)
    runner, chunks = Runner(env, job, jax.local_devices()[:1], length=steps), plan(job, simulations)

    def evaluate() -> float:
        began = time.perf_counter()
        runner.run(chunks, lambda chunk, rows: None)
        return time.perf_counter() - began

    evaluate()
    evaluated, raw = zip(
        *((evaluate(), timed(run, steps // CALL)) for _ in range(REPEATS)), strict=True
    )
    speed = simulations * steps / statistics.median(evaluated)
    return EvaluatorSpeed(
        task=env.task,
        backend=env.backend,
        egos=egos,
        partners=partners,
        episodes=episodes,
        env_steps_per_second=speed,
        pairs_per_second=speed / (env.episode_length * episodes),
        raw_env_steps_per_second=simulations * steps / statistics.median(raw),
        ratio=statistics.median(r / e for e, r in zip(evaluated, raw, strict=True)),
        device=device_name(env.backend),
    )


def device_name(backend: str) -> str:
    """Return the name of the device that a backend computes on."""
    if backend == "native" or jax.default_backend() == "cpu":
        return f"{len(os.sched_getaffinity(0))} CPU cores"
    return jax.devices()[0].device_kind


class Persons:
    """Persons of the family `spring` in the human's seat of a batch."""

    def __init__(self, task: str, batch: int) -> None:
        table = persons(task)
        rows = table[np.arange(batch) % len(table)]
        self.player, self.row = PersonPlayer(task), jnp.asarray(marked(rows))
        self.params = person_params(task, rows)

    def act(self, mind: Any, state: Any) -> tuple[Any, dict[str, jax.Array]]:
        """Return the persons' minds after a step, and what they do and say."""
        given = {"row": self.row}, mind, state.obs["human"], state.step == 0
        mind, action = self.player.act(*given)
        return mind, {"human": action, "word": self.player.word(mind)}


def open_loop(env: Any, batch: int, people: Persons | None = None) -> Any:
    """Return a function that plays `calls` x `CALL` steps from a fresh reset.

    Actions are random, but for those of `people`.
    """

    @jax.jit
    def advance(loop: Any, key: jax.Array) -> Any:
        def body(loop: Any, key: jax.Array) -> tuple[Any, None]:
            state, mind = loop
            actions = {
                role: jax.random.uniform(role_key, (batch, size), minval=-1.0)
                for (role, size), role_key in zip(
                    env.action_size.items(), jax.random.split(key), strict=True
                )
            }
            if people is not None:
                mind, done = people.act(mind, state)
                actions |= done
            return (env.step(state, actions), mind), None

        return jax.lax.scan(body, loop, jax.random.split(key, CALL))[0]

    params = disability_params(_settings(batch)) if people is None else people.params
    start = jax.jit(env.reset)(jax.random.split(jax.random.key(0), batch), params)
    mind = () if people is None else people.player.initial_carry((batch,))

    @functools.cache
    def key(call: int) -> jax.Array:
        return jax.random.key(call)

    def run(calls: int) -> jax.Array:
        loop = start, mind
        for call in range(calls):
            loop = advance(loop, key(call))
        return jnp.sum(loop[0].reward)

    return run


def _calls(env: Any, run: Any, seconds: float) -> int:
    """Return the calls of a repeat that take its share of the time, within an episode."""
    return min(calls_within(run, seconds / REPEATS), max(env.episode_length // CALL, 1))


def _untrained_job(env: Any, shape: tuple[int, int, int]) -> Job:
    """Return a job of E robots with P humans for K episodes, with untrained networks."""
    seats = []
    for role, count in zip(("robot", "human"), shape, strict=False):
        spec = PolicySpec(role, env.observation_size[role], env.action_size[role])
        params = jax.tree.map(
            lambda leaf, n=count: np.repeat(leaf[None], n, 0), Policy(spec).init(jax.random.key(0))
        )
        members = {
            f"{role}-{i}": Member(f"{role}-{i}", "", disability=setting)
            for i, setting in enumerate(_settings(count))
        }
        seats.append(Roster((PolicyStack(spec, tuple(members), params),), members))
    return Job(env.task, env.version, env.backend, seats[0], seats[1], shape[2])


def _settings(count: int) -> list[str]:
    names = list(DISABILITY_SETTINGS)
    return [names[i % len(names)] for i in range(count)]
