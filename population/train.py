"""A training run, from configuration to finished teams in a folder."""

import dataclasses
import datetime
import importlib.metadata
import time
import zlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl

from assistax_envs import disability_params
from population.checkpoints import Checkpoints
from population.config import Member, TrainConfig
from population.ppo import PPO, Hyper, Metrics, TrainState, hyperparameters
from population.rollout import Environment
from population.runs import RunFolder, metrics_table
from population.self_play import self_play

_SELF_PLAY = 1  # folded into a member's key: episodes of the final evaluation
_LOSSES = ("policy_loss", "value_loss", "entropy", "actor_grad_norm", "critic_grad_norm")
_LIBRARIES = ("jax", "flax", "optax", "mujoco")


class DivergedError(ValueError):
    """A loss is no longer a finite number."""


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is."""

    update: int  # updates done
    updates: int  # updates in all
    steps: int  # environment steps done, of all members together
    total_steps: int  # environment steps in all
    steps_per_second: float  # since this process began, without its first compilation
    seconds_left: float  # at that speed
    rows: pl.DataFrame  # metrics of the newest updates: one row for each update and member


def train(
    config: TrainConfig,
    env: Environment,
    folder: Path | str,
    *,
    resume: bool = True,
    progress: Callable[[Progress], None] | None = None,
) -> Path:
    """Train the members of a run and return its folder; a run that was interrupted goes on to the same result.

    Args:
        config: What to train.
        env: The environment of `config.task`.
        folder: Where the run is kept: configuration, checkpoints, metrics, and at the end the teams.
        resume: Whether to go on with a run that the folder holds.
        progress: Called after every dispatch to the device.

    Raises:
        ValueError: Environment and configuration do not fit, or the folder holds another run.
        DivergedError: A loss became NaN or infinite; the last good checkpoint stays.
        OSError: The folder cannot be written.
    """
    if env.task != config.task:
        raise ValueError(f"the environment's task is {env.task!r}, the run's is {config.task!r}; give the same task")
    ppo = PPO(config.ppo, env, config.updates)
    env_params = disability_params([member.disability for member in config.members])
    run = RunFolder(folder)
    run.open(config, {"version": env.version, "backend": env.backend}, resume)
    checkpoints = Checkpoints(run.checkpoints)
    try:
        state, metrics = _load(config, ppo, env_params, run, checkpoints)
        state, metrics = _loop(config, ppo, state, metrics, run, checkpoints, progress)
    finally:
        checkpoints.close()
    if not run.teams.exists():
        _finish(config, ppo, env_params, state, metrics, run)
    return run.folder


def member_key(member: Member) -> jax.Array:
    """Return a member's key: its own, whoever trains beside it."""
    return jax.random.fold_in(jax.random.key(member.seed), zlib.crc32(member.disability.encode()))


def _load(
    config: TrainConfig, ppo: PPO, env_params: Any, run: RunFolder, checkpoints: Checkpoints
) -> tuple[TrainState, list[pl.DataFrame]]:
    """Return the state and metrics of the newest checkpoint, or of the beginning."""
    keys = jnp.stack([member_key(member) for member in config.members])
    simulations = jax.tree.map(lambda leaf: jnp.repeat(leaf, config.ppo.num_envs, axis=0), env_params)
    # Copied, so that no two leaves share a buffer: each is donated to the first update.
    state = jax.tree.map(jnp.copy, jax.jit(ppo.initial)(keys, simulations))
    done = checkpoints.latest()
    if done is None:
        return state, []
    if done > config.updates:
        steps = done * config.ppo.batch_steps
        raise ValueError(f"{run.folder} has already trained {steps} steps; ask for at least that many")
    return checkpoints.restore(done, state), [run.read_metrics(done)]


def _loop(
    config: TrainConfig,
    ppo: PPO,
    state: TrainState,
    metrics: list[pl.DataFrame],
    run: RunFolder,
    checkpoints: Checkpoints,
    progress: Callable[[Progress], None] | None,
) -> tuple[TrainState, pl.DataFrame]:
    """Update until the run is done, saving metrics and then the state every `checkpoint_every` updates."""
    advance = jax.jit(partial(_advance, ppo), static_argnames="updates", donate_argnames="state")
    hyper = hyperparameters(config.ppo, config.members)
    done = int(state.update)
    if done < config.updates:
        run.teams.unlink(missing_ok=True)
    clock = _Clock(float(metrics[-1]["seconds"][-1]) if metrics else 0.0, done)
    while done < config.updates:
        updates = min(config.updates_per_call, config.updates - done)
        state, values = advance(state, hyper, updates=updates)
        values = jax.device_get(values)
        rows = metrics_table(values, config.members, done, config.ppo.batch_steps, clock.seconds())
        metrics.append(rows)
        done += updates
        saving = done // config.checkpoint_every > (done - updates) // config.checkpoint_every or done == config.updates
        if bad := _diverged(values, config):
            run.write_metrics(pl.concat(metrics))
            raise DivergedError(_divergence(bad, rows, config, checkpoints))
        if saving:
            metrics = [pl.concat(metrics)]
            run.write_metrics(metrics[0])
            checkpoints.save(done, state)
        if progress is not None:
            progress(clock.progress(config, done, rows))
    return state, pl.concat(metrics)


def _advance(ppo: PPO, state: TrainState, hyper: Hyper, *, updates: int) -> tuple[TrainState, Metrics]:
    return jax.lax.scan(lambda state, _: ppo.update(state, hyper), state, length=updates)


class _Clock:
    """Training time of a run over all its processes, and speed since this one's first dispatch."""

    def __init__(self, before: float, done: int) -> None:
        self._before, self._start = before, time.perf_counter()
        self._first: tuple[float, int] | None = None
        self._done = done

    def seconds(self) -> float:
        return self._before + time.perf_counter() - self._start

    def progress(self, config: TrainConfig, done: int, rows: pl.DataFrame) -> Progress:
        now = time.perf_counter()
        since, start = self._first or (self._start, self._done)
        self._first = self._first or (now, done)
        batch = config.ppo.batch_steps * len(config.members)
        speed = (done - start) * batch / (now - since)
        total = config.updates * batch
        return Progress(done, config.updates, done * batch, total, speed, (total - done * batch) / speed, rows)


def _diverged(values: Mapping[str, np.ndarray], config: TrainConfig) -> tuple[str, int] | None:
    """Return the first metric that is not finite and the member it belongs to."""
    for name, value in values.items():
        if name.startswith(_LOSSES) and not np.isfinite(value).all():
            return name, int(np.argwhere(~np.isfinite(value))[0, 1])
    return None


def _divergence(bad: tuple[str, int], rows: pl.DataFrame, config: TrainConfig, checkpoints: Checkpoints) -> str:
    name, index = bad
    member, last = config.members[index], checkpoints.latest()
    kept = f"the last good checkpoint is of update {last}" if last else "no checkpoint was written yet"
    rate = member.overrides.get("learning_rate", config.ppo.learning_rate)
    return (
        f"training diverged: {name} of member {member.label} is {rows[name][index]} "
        f"by update {rows['update'].max()}; {kept} in {checkpoints.folder}; "
        f"start a new run with a learning_rate below {rate:g} or a max_grad_norm below {config.ppo.max_grad_norm:g}"
    )


def _finish(
    config: TrainConfig, ppo: PPO, env_params: Any, state: TrainState, metrics: pl.DataFrame, run: RunFolder
) -> None:
    """Evaluate the final policies in self-play and write the teams."""
    params = jax.jit(ppo.policy_params)(state.members)
    results: list[dict[str, Any] | None] = [None] * len(config.members)
    if config.self_play_episodes:
        keys = jnp.stack([jax.random.fold_in(member_key(member), _SELF_PLAY) for member in config.members])
        results[:] = self_play(ppo.env, ppo.policies, params, env_params, keys, config.self_play_episodes)
    training = _provenance(config, ppo.env, float(metrics["seconds"][-1]))
    run.write_teams(config, ppo.specs, jax.device_get(params), training, results)


def _provenance(config: TrainConfig, env: Environment, seconds: float) -> Mapping[str, Any]:
    """Return what a registry says about a run."""
    return {
        "steps": config.updates * config.ppo.batch_steps,
        "env_version": env.version,
        "backend": env.backend,
        "date": datetime.date.today().isoformat(),
        "device": jax.devices()[0].device_kind,
        "seconds": round(seconds, 1),
        "versions": {name: importlib.metadata.version(name) for name in _LIBRARIES},
        "hyperparameters": {**dataclasses.asdict(config.ppo), "hidden": list(config.ppo.hidden)},
    }
