"""Simulate chunks on the devices of this host, and return their episodes as rows.

Each device has a thread that takes the next chunk after finishing one. All devices run the same
program, so a chunk's values do not depend on its device. On a CPU one program leaves cores idle,
because XLA computes small matrix products on one core. So JAX gets several CPU devices before it
starts, and each plays its own tiles.
"""

import concurrent.futures
import contextlib
import dataclasses
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import polars as pl

from assistax_envs import EnvParams
from assistax_envs.interrupts import wait_for
from assistax_envs.own_settings import own_settings
from evaluation.cast.egos import Clipping, call_ego
from evaluation.cast.roster import HostEgo, Roster
from evaluation.play.jobs import Job
from evaluation.play.progress import Meter
from evaluation.play.rows import played_rows
from evaluation.play.tiles import TILE_ENVS, Chunk, StackSlice, Tile, plan
from population.devices import own_devices
from population.networks.seat import Seat
from population.networks.stack import PolicyStack
from population.play.rollout import Rollout
from population.play.tally import Tally
from population.views import View

MOST_DEVICES = 8  # each has a tile of up to 32,768 simulations in memory
# For fewer simulations, compiling the programs for another device takes longer than it saves.
SIMULATIONS_OF_A_CORE = 8192


def share_cores() -> None:
    """Give JAX a CPU device for each core, unless it has started or has a configured number."""
    if "xla_force_host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    if jax.config.values["jax_num_cpu_devices"] < 0:
        # JAX raises it if it has started.
        with contextlib.suppress(RuntimeError):
            jax.config.update("jax_num_cpu_devices", min(os.cpu_count() or 1, MOST_DEVICES))


def devices_for(simulations: int) -> tuple[jax.Device, ...]:
    """Return the devices to use for this number of simulations."""
    return own_devices(simulations // SIMULATIONS_OF_A_CORE)


class Runner:
    """Runner of the chunks of one job that keeps compiled programs."""

    def __init__(
        self,
        env: Any,
        job: Job,
        devices: Sequence[jax.Device] | None = None,
        length: int | None = None,
    ) -> None:
        """Prepare to run.

        Args:
            env: The environment.
            job: The job to play.
            devices: Devices to run on; by default `devices_for`. If a robot is from outside, only
                the first one is used.
            length: Steps to play, if fewer than an episode's, for measuring speed.
        """
        self._env, self._job, self._length = env, job, length
        self._devices = tuple(devices or devices_for(job.rows))
        if job.egos.hosts:
            self._devices = self._devices[:1]
        self._rollouts: dict[Any, Rollout] = {}
        self._lock = threading.Lock()

    @property
    def compile_seconds(self) -> float:
        """Seconds spent waiting for compilation, on the device with the longest wait."""
        return max(
            (sum(r.compile_seconds[d] for r in self._rollouts.values()) for d in self._devices),
            default=0.0,
        )

    def run(
        self,
        chunks: Sequence[Chunk],
        save: Callable[[Chunk, pl.DataFrame], None],
        meter: Meter | None = None,
    ) -> None:
        """Simulate chunks, and call `save` with the rows of each finished chunk."""
        queue, meter = iter(chunks), meter or Meter(0)
        pool = concurrent.futures.ThreadPoolExecutor
        # In threads even for one device: see `assistax_envs.interrupts`.
        with (
            contextlib.ExitStack() as robots,
            pool(len(self._devices)) as playing,
            pool(_compilers()) as compiling,
        ):
            for host in self._job.egos.hosts:
                robots.enter_context(host.act.playing())
            works = [
                playing.submit(self._work, device, queue, save, meter) for device in self._devices
            ]
            for tile in _first_of_each_program(chunks)[1:]:
                for device in self._devices:
                    compiling.submit(self._prepare, device, tile)
            try:
                wait_for(works)
            except BaseException:
                meter.stop()
                raise
            finally:
                compiling.shutdown(wait=False, cancel_futures=True)

    def _work(
        self,
        device: jax.Device,
        queue: Iterator[Chunk],
        save: Callable[[Chunk, pl.DataFrame], None],
        meter: Meter,
    ) -> None:
        """Take chunks from the queue and run them on one device until the queue is empty."""
        while True:
            with self._lock:
                chunk = next(queue, None)
            if chunk is None:
                return
            save(chunk, pl.concat([self._run_tile(device, tile, meter) for tile in chunk.tiles]))

    def _prepare(self, device: jax.Device, tile: Tile) -> None:
        """Compile a tile's programs ahead; errors are ignored, and raised again by playing it."""
        rollout, block, _ = self._block(tile)
        rollout.prepare(*block, device)

    def _run_tile(self, device: jax.Device, tile: Tile, meter: Meter) -> pl.DataFrame:
        job, act = self._job, None
        rollout, block, partners = self._block(tile)
        if host := _host(job, tile):
            answer = call_ego(host, partners, tile.at_once, self._env.action_size["robot"])
            act = Clipping(answer, self._length or self._env.episode_length)
        before, counted = rollout.compile_seconds[device], 0.0
        began = time.perf_counter()

        def on_steps(steps: int) -> None:
            nonlocal counted
            spent = time.perf_counter() - began - (rollout.compile_seconds[device] - before)
            counted, seconds = spent, spent - counted
            meter.add(device, steps * tile.rows // job.series, seconds)

        tally = _run(job, rollout, tile, *block, act=act, on_steps=on_steps, device=device)
        return played_rows(job, tile, tally, act)

    @own_settings()
    def _block(self, tile: Tile) -> tuple[Rollout, tuple[Any, ...], tuple[str, ...]]:
        """Return a tile's rollout, the rollout's arguments, and the ids of the tile's partners.

        The arguments are the robots' parameters, the humans' parameters, the humans [P] and the
        seeds [K] or [P, K].
        """
        job = self._job
        robots = [] if _host(job, tile) else _padded_stacks(job.egos, tile.egos)
        humans = _padded_stacks(job.partners, tile.partners)
        ids = tuple(name for stack in humans for name in stack.ids)
        episodes = _padded(tile.episodes, tile.at_once * job.series)
        block = (
            [stack.params for stack in robots],
            [stack.params for stack in humans],
            _humans(job, humans, ids, episodes),
            job.seeds(ids, episodes),
        )
        specs = (tuple(stack.spec for stack in seat) for seat in (robots, humans))
        return self._rollout(*specs), block, ids

    def _rollout(self, robots: tuple[Seat, ...], humans: tuple[Seat, ...]) -> Rollout:
        key = robots, humans
        with self._lock:
            if key not in self._rollouts:
                options = {
                    "stochastic": self._job.stochastic,
                    "paired": self._job.paired,
                    "length": self._length,
                    "series": self._job.series,
                    "columns": self._job.columns,
                }
                seats = ([spec.player() for spec in seat] for seat in key)
                self._rollouts[key] = Rollout(self._env, *seats, **options)
            return self._rollouts[key]


def play(env: Any, job: Job, max_envs: int) -> pl.DataFrame:
    """Return a job's episodes in the order of simulation, without writing files."""
    parts: list[pl.DataFrame] = []
    Runner(env, job).run(plan(job, max_envs), lambda chunk, rows: parts.append(rows))
    return pl.concat(parts)


def _run(job: Job, rollout: Rollout, tile: Tile, *args: Any, **options: Any) -> Tally:
    """Run a rollout and return its tally; if memory runs out, raise a ValueError with advice."""
    try:
        return rollout.run(*args, **options)
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        simulations = math.prod(tile.shape)
        advice = f"give {max(simulations // 2, 1)} or less as max_envs"
        if job.backend in TILE_ENVS:
            advice = "stop what else uses the memory"
        raise ValueError(f"out of memory with {simulations} simulations; {advice}") from error


def _compilers() -> int:
    """Return the number of compiling threads, few enough to leave cores for the simulation."""
    return max(1, (os.cpu_count() or 1) // 4)


def _first_of_each_program(chunks: Sequence[Chunk]) -> list[Tile]:
    """Return the first tile of each program, in the order of play."""
    first: dict[Any, Tile] = {}
    for chunk in chunks:
        for tile in chunk.tiles:
            first.setdefault(tile.program, tile)
    return list(first.values())


def _host(job: Job, tile: Tile) -> HostEgo | None:
    """Return the robot from outside that plays in a tile, or None."""
    return job.egos.host(tile.egos[0].stack)


def _humans(
    job: Job, stacks: Sequence[PolicyStack], ids: Sequence[str], episodes: Sequence[int]
) -> EnvParams:
    """Return the bodies and preferences [P] of stacks, as their specs give them."""
    settings = [member.setting or str(member.disability) for member in job.partners.describe(ids)]
    preferences = job.preferences_of(ids, episodes) if job.preferences else None
    parts, start = [], 0
    for stack in stacks:
        rows = slice(start, start := start + len(stack))
        codes = None if preferences is None else preferences[rows]
        parts.append(stack.spec.humans(stack.params, settings[rows], codes))
    humans: EnvParams = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)
    if job.view is not View.NUMBERS:
        return humans
    places = [job.partners.ids.index(name) for name in ids]
    return dataclasses.replace(humans, person=jnp.asarray(places, jnp.int32))


def _padded_stacks(roster: Roster, slices: Sequence[StackSlice]) -> list[PolicyStack]:
    """Return the policies of a seat's slices, the last of each repeated as padding."""
    stacks = [(roster.stacks[cut.stack], _padded(cut.rows, cut.width)) for cut in slices]
    return [stack.take(rows) for stack, rows in stacks if isinstance(stack, PolicyStack)]


def _padded(rows: range, width: int) -> list[int]:
    """Return the rows as a list of `width` items, the last row repeated."""
    return [rows[min(i, len(rows) - 1)] for i in range(width)]
