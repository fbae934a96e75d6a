"""Speed of training, and shares of its parts. Compilation is not counted."""

import dataclasses
import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp

from benchmarks.timing import REPEATS, calls_within, timed
from population.config import Member, TrainConfig
from population.environment import Environment
from population.hyperparameters import SACConfig, TrainerConfig
from population.runs.train import initial_state, make_trainer
from population.trainers.trainer import Trainer


@dataclasses.dataclass(frozen=True)
class TrainSpeed:
    """Speed of several members' training; the shares are of a whole update's time."""

    task: str
    backend: str
    algorithm: str
    members: int
    num_envs: int  # of each member
    rollout_steps: int
    env_steps_per_second: float  # of training, all members together, median
    repeats: tuple[float, ...]
    physics_share: float  # stepping the environment alone
    networks_share: float  # acting and recording, beside the physics
    updates_share: float  # the rest: learning
    device: str


def measure_training(
    env: Environment, algorithm: str, config: TrainerConfig, members: int = 1, seconds: float = 6.0
) -> TrainSpeed:
    """Measure env steps/s of training; physics, collecting and whole updates are timed in turns."""
    steps = config.batch_steps
    team = tuple(Member(seed, "d1") for seed in range(members))
    # As long as a replay, if there is one, so that it has the size of a real run's.
    run = TrainConfig(env.task, algorithm, team, getattr(config, "replay_size", steps), config)
    trainer = make_trainer(run, env)
    state, hyper = initial_state(run, trainer), trainer.hyper(run.members)
    if isinstance(config, SACConfig):
        state = dataclasses.replace(
            state, update=jnp.asarray(config.exploration_steps // steps + 1, jnp.int32)
        )
    work = _work(trainer, config.rollout_steps, state, hyper)
    for function in work.values():
        function(1)
    share = seconds / (REPEATS * len(work))
    calls = {name: calls_within(function, share) for name, function in work.items()}
    times: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(REPEATS):
        for name, function in work.items():
            times[name].append(timed(function, calls[name]) / calls[name])
    whole, collected, stepped = (statistics.median(times[name]) for name in work)
    return TrainSpeed(
        task=env.task,
        backend=env.backend,
        algorithm=algorithm,
        members=members,
        num_envs=config.num_envs,
        rollout_steps=config.rollout_steps,
        env_steps_per_second=members * steps / whole,
        repeats=tuple(members * steps / seconds for seconds in times["update"]),
        physics_share=stepped / whole,
        networks_share=(collected - stepped) / whole,
        updates_share=1.0 - collected / whole,
        device=jax.devices()[0].device_kind,
    )


def _work(
    trainer: Trainer, rollout_steps: int, state: Any, hyper: Any
) -> dict[str, Callable[[int], Any]]:
    """Return the timed functions by name; each repeats its work a number of times."""
    update = jax.jit(trainer.update, donate_argnums=0)
    # What learning reads is returned, so that nothing of acting is optimised away.
    collect = jax.jit(lambda state: _used(trainer.collect(state)))
    physics = jax.jit(partial(_physics, trainer.env, rollout_steps))

    def updates(calls: int) -> Any:
        nonlocal state
        for _ in range(calls):
            state, metrics = update(state, hyper)
        return metrics

    return {
        "update": updates,
        "collect": lambda calls: [collect(_light(state)) for _ in range(calls)],
        "physics": lambda calls: [physics(state.simulations.env) for _ in range(calls)],
    }


def _light(state: Any) -> Any:
    """Return a state without its replay, which collecting does not read."""
    return dataclasses.replace(state, replay=())


def _used(collected: tuple[Any, Any, Any]) -> tuple[Any, Any]:
    state, batch, _ = collected
    return state.simulations, batch


def _physics(env: Environment, steps: int, state: Any) -> Any:
    """Step the environment with fixed actions, after the reset that every rollout makes."""
    n = state.step.shape[0]
    fresh = env.reset(state.key, state.params)
    action = {role: jnp.full((n, size), 0.1) for role, size in env.action_size.items()}
    state, reward = jax.lax.scan(
        lambda state, _: ((after := env.step(state, action)), after.reward), state, length=steps
    )
    return state.step, reward, fresh.reward
