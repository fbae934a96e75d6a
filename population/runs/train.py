"""Training of a run, from its configuration to finished teams in a folder."""

import contextlib
import dataclasses
import datetime
import shutil
import zlib
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import polars as pl

from assistax_envs import disability_params
from assistax_envs.interrupts import StoppedError, interruptible
from assistax_envs.own_settings import key_of, own_settings
from population.config import MIXED, Member, TrainConfig
from population.devices import SECOND_AXIS, WHOLE, DeviceShares, state_specs
from population.environment import Environment, environment_facts
from population.hyperparameters import DAggerConfig, PPOConfig
from population.networks.stack import PolicyStack
from population.partners.frozen import FrozenPartners
from population.play.self_play import self_play
from population.runs.checkpoints import Checkpoints
from population.runs.divergence import DivergedError, describe_divergence, find_divergence
from population.runs.folder import RunFolder, extends, metrics_table
from population.runs.progress import Clock, Progress
from population.trainers.dagger import DAgger
from population.trainers.ppo import PPO
from population.trainers.sac import SAC
from population.trainers.trainer import Trainer, TrainState

_SELF_PLAY = 1  # folded into a member's key for the final evaluation's episodes
_LIBRARIES = ("jax", "flax", "optax", "mujoco")


@own_settings()
def train(
    config: TrainConfig,
    env: Environment,
    folder: Path | str,
    *,
    partners: FrozenPartners | None = None,
    teacher: PolicyStack | None = None,
    resume: bool = True,
    stop_on_divergence: bool = True,
    snapshots: int = 0,
    progress: Callable[[Progress], None] = lambda state: None,
    devices: Sequence[jax.Device] | None = None,
) -> Path:
    """Train the members of a run and return its folder.

    An interrupted run resumes to the same result, on other devices too. Several devices share the
    members: as many as divide their number. With partners, which are frozen, a member is an ego.

    Args:
        config: The run's configuration.
        env: The environment of `config.task`.
        folder: Folder for configuration, checkpoints, metrics, and at the end the teams.
        partners: Partners in the other seat, as `config.partners` names them.
        teacher: Of each member, for DAgger.
        resume: Whether to resume a run that the folder holds.
        stop_on_divergence: Whether a loss that is not finite ends the run.
        snapshots: Number of equal parts of the run after which the policies are saved.
        progress: Called after every dispatch to the devices.
        devices: Devices that may be used; default as for `DeviceShares`.

    Raises:
        ValueError: Environment and configuration do not fit, or the folder holds another run.
        DivergedError: A loss became NaN or infinite; the last good checkpoint stays.
        OSError: The folder cannot be written.
    """
    _check(config, env, partners)
    trainer, run = make_trainer(config, env, partners, teacher), RunFolder(folder)
    run.open(config, environment_facts(env, config.trainer.packages), resume)
    if run.finished(config):
        return run.folder

    def work(check: Callable[[], None]) -> None:
        def report(state: Progress) -> None:
            check()
            progress(state)

        # Each member of a population reads all others, so one device holds them.
        groups = 1 if config.trainer.population_coef else len(config.members)
        with (
            DeviceShares(groups, devices) as shares,
            contextlib.closing(Checkpoints(run.checkpoints, run.key)) as checkpoints,
        ):
            training = _Training(config, trainer, shares, run, checkpoints, snapshots)
            training.finish(*training.loop(*training.load(), report, stop_on_divergence))

    interruptible(own_settings()(work))
    if not extends(config.trainer):
        # No longer run can continue from them, and each holds a replay for every member.
        shutil.rmtree(run.checkpoints, ignore_errors=True)
    return run.folder


def make_trainer(
    config: TrainConfig,
    env: Environment,
    partners: FrozenPartners | None = None,
    teacher: PolicyStack | None = None,
) -> Trainer:
    """Return the trainer of a run; see `train`."""
    if isinstance(config.trainer, DAggerConfig):
        return DAgger(config.trainer, env, config.updates, partners, teacher, len(config.members))
    if teacher:
        raise ValueError(
            f"a teacher is given, and algorithm {config.algorithm!r} learns from rewards; leave "
            f"the teacher out, or choose {DAggerConfig.kind}"
        )
    if isinstance(config.trainer, PPOConfig):
        return PPO(config.trainer, env, config.updates, partners)
    return SAC(config.trainer, env, config.updates, partners)


def initial_state(
    config: TrainConfig, trainer: Trainer, shares: DeviceShares | None = None
) -> TrainState:
    """Return a run's state before its first update; on one device if `shares` is None."""
    shares = shares or DeviceShares(len(config.members), jax.local_devices()[:1])
    keys = jnp.stack([member_key(member) for member in config.members])
    envs, partners = config.trainer.num_envs, trainer.partners
    humans = [
        partners.humans(envs, config.preferences, place)
        if partners
        else disability_params([member.disability] * envs)
        for place, member in enumerate(config.members)
    ]
    start = shares.put((keys, jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *humans)))
    specs = state_specs(jax.eval_shape(trainer.initial, *start), partners)
    initial = shares.jit(trainer.initial, specs)
    # Copied, since every leaf is donated to the first update and two leaves may share a buffer.
    return jax.tree.map(jnp.copy, initial(*start))


def member_key(member: Member) -> jax.Array:
    """Return a member's key, which does not depend on the members beside it.

    JAX keeps 32 bits of a seed, so higher bits are folded in: seeds of seasons have 63.
    """
    key = key_of(member.seed)
    if upper := member.seed >> 32:
        key = jax.random.fold_in(key, upper)
    return jax.random.fold_in(key, zlib.crc32(member.disability.encode()))


def _check(config: TrainConfig, env: Environment, partners: FrozenPartners | None) -> None:
    """Refuse environment, configuration and partners that do not belong together."""
    if env.task != config.task:
        raise ValueError(
            f"the environment's task is {env.task!r}, the run's is {config.task!r}; give the same "
            "task"
        )
    if config.partners != (partners.ids if partners else ()):
        raise ValueError(
            "the partners given are not those that the configuration names; give the same, in its "
            "order"
        )
    for member in config.members:
        if (member.disability == MIXED) != bool(partners):
            raise ValueError(
                f"member {member.label} has disability {member.disability!r}; an ego with partners "
                f"has {MIXED!r}, because each partner brings its own, and a team has one of d1 to "
                "d9"
            )


@dataclasses.dataclass(frozen=True)
class _Training:
    """Training of one run, from its newest checkpoint to its teams."""

    config: TrainConfig
    trainer: Trainer
    shares: DeviceShares
    run: RunFolder
    checkpoints: Checkpoints
    snapshots: int

    def load(self) -> tuple[TrainState, list[pl.DataFrame]]:
        """Return state and metrics of the newest intact checkpoint, or of the run's beginning."""
        state = initial_state(self.config, self.trainer, self.shares)
        restored = self.checkpoints.restore_latest(state)
        if restored is None:
            return state, []
        done, state = restored
        if done > self.config.updates:
            raise ValueError(
                f"{self.run.folder} has already trained "
                f"{done * self.config.trainer.batch_steps} steps; ask for at least that many"
            )
        return state, [self.run.read_metrics(done)]

    def loop(
        self,
        state: TrainState,
        metrics: list[pl.DataFrame],
        progress: Callable[[Progress], None],
        stop_on_divergence: bool,
    ) -> tuple[TrainState, pl.DataFrame]:
        """Return state and metrics after all updates, saving both every `checkpoint_every` updates.

        The last state, and the state at Ctrl-C, is saved only if a longer run can continue from it:
        with a replay for each member it may be large.
        """
        config, done = self.config, int(state.update)
        advance = self._advance(state)
        if done < config.updates:
            self.run.teams.unlink(missing_ok=True)
        clock = Clock(float(metrics[-1]["seconds"][-1]) if metrics else 0.0, done)
        while done < config.updates:
            updates = min(config.updates_per_call, config.updates - done)
            state, values = advance(state, updates)
            rows = metrics_table(
                values, config.members, done, config.trainer.batch_steps, clock.seconds()
            )
            metrics.append(rows)
            before, done = done, done + updates
            saving = done // config.checkpoint_every > (done - updates) // config.checkpoint_every
            ending = done == config.updates
            if stop_on_divergence and (bad := find_divergence(values)):
                self.run.write_metrics(pl.concat(metrics, how="diagonal"))
                raise DivergedError(describe_divergence(bad, rows, config, self.checkpoints))
            if saving or ending:
                metrics = [pl.concat(metrics, how="diagonal")]
                self.run.write_metrics(metrics[0])
            if extends(config.trainer) if ending else saving:
                self.checkpoints.save(done, state)
            if done * self.snapshots // config.updates > before * self.snapshots // config.updates:
                self._snapshot(done, state, clock.seconds())
            try:
                progress(clock.progress(config, done, rows))
            except StoppedError:  # Ctrl-C; the run goes on from here
                if not (saving or ending) and extends(config.trainer):
                    self.run.write_metrics(pl.concat(metrics, how="diagonal"))
                    self.checkpoints.save(done, state)
                raise
        return state, pl.concat(metrics, how="diagonal")

    def _advance(
        self, state: TrainState
    ) -> Callable[[TrainState, int], tuple[TrainState, dict[str, np.ndarray]]]:
        """Return a function that makes updates and returns the state and metrics [updates, M]."""
        trainer, shares = self.trainer, self.shares

        def scan(state: Any, hyper: Any, partners: Any, *, updates: int) -> Any:
            return jax.lax.scan(
                lambda state, _: trainer.update(state, hyper, partners), state, length=updates
            )

        specs = (state_specs(state, trainer.partners), SECOND_AXIS)
        jitted = shares.jit(scan, specs, static_argnames="updates", donate_argnames="state")
        hyper = shares.put(trainer.hyper(self.config.members))
        partners = shares.put(trainer.partners.params if trainer.partners else (), WHOLE)

        def advance(state: TrainState, updates: int) -> tuple[TrainState, dict[str, np.ndarray]]:
            state, values = jitted(state, hyper, partners, updates=updates)
            return state, jax.device_get(values)

        return advance

    def _snapshot(self, done: int, state: TrainState, seconds: float) -> None:
        """Write a snapshot of the policies after `done` updates."""
        config = dataclasses.replace(self.config, steps=done * self.config.trainer.batch_steps)
        written = jax.device_get(self._written(state))
        training = _provenance(config, self.trainer.env, self.shares, seconds)
        figures = [None] * len(config.members)
        kept = self.run.snapshot(done)
        kept.folder.mkdir(parents=True, exist_ok=True)
        kept.write_teams(config, self.trainer.specs, written, training, figures)

    def _written(self, state: TrainState) -> Any:
        """Return the policies' parameters in the precision in which they are written."""
        # On one device, since a few episodes of each team cost less than an update.
        params = jax.jit(self.trainer.policy_params)(self.shares.gather(state.members))
        return jax.tree.map(lambda leaf: leaf.astype(self.config.precision), params)

    def finish(self, state: TrainState, metrics: pl.DataFrame) -> None:
        """Write the final policies, with figures of their self-play unless they are egos."""
        config, trainer = self.config, self.trainer
        written = self._written(state)
        # Readers load them in float32.
        params = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), written)
        figures: list[dict[str, Any] | None] = [None] * len(config.members)
        if config.self_play_episodes and not trainer.partners:
            figures[:] = self_play(
                trainer.env,
                trainer.policies,
                params,
                disability_params([member.disability for member in config.members]),
                jnp.stack([jax.random.fold_in(member_key(m), _SELF_PLAY) for m in config.members]),
                config.self_play_episodes,
            )
        seconds = float(metrics["seconds"][-1])
        training = _provenance(config, trainer.env, self.shares, seconds)
        self.run.write_teams(config, trainer.specs, jax.device_get(written), training, figures)


def _provenance(
    config: TrainConfig, env: Environment, shares: DeviceShares, seconds: float
) -> Mapping[str, Any]:
    """Return the facts of a run that the registry records."""
    preferences = {"preferences": list(config.preferences)} if config.preferences else {}
    return (
        preferences
        | config.view.claim
        | {
            "steps": config.updates * config.trainer.batch_steps,
            "env_version": env.version,
            "backend": env.backend,
            "date": datetime.date.today().isoformat(),
            "device": shares.devices[0].device_kind,
            "devices": len(shares),
            "seconds": round(seconds, 1),
            "versions": {name: version(name) for name in (*_LIBRARIES, *config.trainer.packages)},
            "hyperparameters": {
                **dataclasses.asdict(config.trainer),
                "hidden": list(config.trainer.hidden),
            },
        }
    )
