"""Simulate chunks on the devices of this host, and lay what they gave out as rows.

Each device has a thread that takes the next chunk when it is done with one. Which device a chunk
runs on does not show in its values: all run the same program.
"""

import concurrent.futures
import dataclasses
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import jax
import numpy as np
import polars as pl

from assistax_envs import disability_params
from assistax_envs.interrupts import wait_for
from evaluation.cast.egos import Clipping, call_ego
from evaluation.cast.players import make_player
from evaluation.cast.roster import HostEgo, Roster
from evaluation.play.devices import devices_for
from evaluation.play.jobs import TILE_ENVS, Chunk, Job, Share, Tile, plan
from evaluation.play.rollout import Rollout, Tally
from evaluation.record.columns import SCHEMA, TERM_PREFIX
from population.networks.spec import PolicySpec
from population.networks.stack import PolicyStack


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a run is, in environment steps of this process."""

    done: int
    total: int
    seconds: float  # spent in the environment and the networks, compilation not counted
    what: str = "policies"  # whose episodes these are


OnProgress = Callable[[Progress], None] | None  # told how far a run is


class Meter:
    """Counts what all devices have done, and tells the caller."""

    def __init__(self, total: int, on_progress: OnProgress = None) -> None:
        self._total, self._on_progress = total, on_progress
        self._done, self._seconds = 0, {}
        self._lock = threading.Lock()
        self._stopped = False

    @property
    def speed(self) -> float | None:
        """Environment steps per second of all devices together; None before the first step."""
        return self._done / self._longest() if self._done else None

    def report(self) -> None:
        """Tell the caller how far the run is."""
        if self._on_progress is not None:
            self._on_progress(Progress(self._done, self._total, self._longest()))

    def add(self, device: jax.Device, steps: int, seconds: float) -> None:
        """Count steps that a device has just done."""
        with self._lock:
            if self._stopped:
                raise _StoppedError
            self._done += steps
            self._seconds[device] = self._seconds.get(device, 0.0) + seconds
            self.report()

    def stop(self) -> None:
        """Make every device stop when it next has something to count."""
        self._stopped = True

    def _longest(self) -> float:
        return max(self._seconds.values(), default=0.0)


class _StoppedError(Exception):
    """Another device failed, or the run was interrupted."""


class Runner:
    """Runs the chunks of one job, keeping what was compiled."""

    def __init__(
        self,
        env: Any,
        job: Job,
        devices: Sequence[jax.Device] | None = None,
        length: int | None = None,
    ) -> None:
        """Prepare to run.

        Args:
            env: the environment.
            job: what is evaluated.
            devices: where to run; see `evaluation.play.devices` if not given. A robot from outside
            is
                called by one only.
            length: steps to play, if fewer than an episode's: for measuring speed.
        """
        self._env, self._job, self._length = env, job, length
        self._devices = tuple(devices or devices_for(job.rows))
        if any(isinstance(ego, HostEgo) for ego in job.egos.stacks):
            self._devices = self._devices[:1]
        self._rollouts: dict[Any, Rollout] = {}
        self._lock = threading.Lock()

    @property
    def compile_seconds(self) -> float:
        """Seconds for which compilation was waited, on the device where it took longest."""
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
        """Simulate chunks and `save` the rows of each, padding dropped, when it is done."""
        queue, meter = iter(chunks), meter or Meter(0)
        pool = concurrent.futures.ThreadPoolExecutor
        # In threads even for one device: see `assistax_envs.interrupts`.
        with pool(len(self._devices)) as playing, pool(_compilers()) as compiling:
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
        """Run what is left in the queue, chunk by chunk, on one device."""
        while True:
            with self._lock:
                chunk = next(queue, None)
            if chunk is None:
                return
            save(chunk, pl.concat([self._run_tile(device, tile, meter) for tile in chunk.tiles]))

    def _prepare(self, device: jax.Device, tile: Tile) -> None:
        """Compile a tile's programs while others play; an error comes again when it is played."""
        rollout, block, _ = self._block(tile)
        rollout.prepare(*block, device)

    def _run_tile(self, device: jax.Device, tile: Tile, meter: Meter) -> pl.DataFrame:
        job, act = self._job, None
        rollout, block, partners = self._block(tile)
        if host := _host(job, tile):
            asked = call_ego(host, partners, tile.at_once, self._env.action_size["robot"])
            act = Clipping(asked, self._length or self._env.episode_length)
        before, counted = rollout.compile_seconds[device], 0.0
        began = time.perf_counter()

        def on_steps(steps: int) -> None:
            nonlocal counted
            spent = time.perf_counter() - began - (rollout.compile_seconds[device] - before)
            counted, seconds = spent, spent - counted
            meter.add(device, steps * tile.rows // job.series, seconds)

        tally = _run(job, rollout, tile, *block, act=act, on_steps=on_steps, device=device)
        return _rows(job, tile, tally, act)

    def _block(self, tile: Tile) -> tuple[Rollout, tuple[Any, ...], tuple[str, ...]]:
        """Return what plays a tile, its parameters and seeds, and the ids of its partners."""
        job = self._job
        robots = [] if _host(job, tile) else _taken(job.egos, tile.egos)
        humans = _taken(job.partners, tile.partners)
        ids = tuple(name for stack in humans for name in stack.ids)
        settings = [
            member.setting or str(member.disability) for member in job.partners.describe(ids)
        ]
        episodes = _padded(tile.episodes, tile.at_once * job.series)
        wishes = job.wishes(ids, episodes) if job.preferences else None
        block = (
            [stack.params for stack in robots],
            [stack.params for stack in humans],
            disability_params(settings, wishes),
            job.seeds(ids, episodes),
        )
        specs = (tuple(stack.spec for stack in seat) for seat in (robots, humans))
        return self._rollout(*specs), block, ids

    def _rollout(self, robots: tuple[PolicySpec, ...], humans: tuple[PolicySpec, ...]) -> Rollout:
        key = robots, humans
        with self._lock:
            if key not in self._rollouts:
                options = {
                    "stochastic": self._job.stochastic,
                    "paired": self._job.paired,
                    "length": self._length,
                    "series": self._job.series,
                }
                seats = ([make_player(spec) for spec in seat] for seat in key)
                self._rollouts[key] = Rollout(self._env, *seats, **options)
            return self._rollouts[key]


def play(env: Any, job: Job, max_envs: int) -> pl.DataFrame:
    """Return a job's episodes, in the order in which they were simulated; nothing is written."""
    parts: list[pl.DataFrame] = []
    Runner(env, job).run(plan(job, max_envs), lambda chunk, rows: parts.append(rows))
    return pl.concat(parts)


def _run(job: Job, rollout: Rollout, tile: Tile, *args: Any, **options: Any) -> Tally:
    """Run a rollout; where memory runs out, say what to do."""
    try:
        return rollout.run(*args, **options)
    except jax.errors.JaxRuntimeError as error:
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        simulations = math.prod(tile.shape)
        advice = f"use --max-envs {max(simulations // 2, 1)} or less"
        if job.backend in TILE_ENVS:
            advice = "stop what else uses the memory"
        raise ValueError(f"out of memory with {simulations} simulations; {advice}") from error


def _compilers() -> int:
    """Return how many programs are compiled beside the one that plays: it needs the cores too."""
    return max(1, (os.cpu_count() or 1) // 4)


def _first_of_each_program(chunks: Sequence[Chunk]) -> list[Tile]:
    """Return a tile of each pair of stacks and shape, in the order in which they are played."""
    found: dict[Any, Tile] = {}
    for chunk in chunks:
        for tile in chunk.tiles:
            found.setdefault(tile.program, tile)
    return list(found.values())


def _host(job: Job, tile: Tile) -> HostEgo | None:
    """Return the robot from outside that plays in a tile, if one does."""
    stack = job.egos.stacks[tile.egos[0].stack]
    return stack if isinstance(stack, HostEgo) else None


def _taken(roster: Roster, shares: Sequence[Share]) -> list[PolicyStack]:
    """Return the policies of a seat's shares, padded."""
    taken = []
    for share in shares:
        stack = roster.stacks[share.stack]
        assert isinstance(stack, PolicyStack)
        taken.append(stack.take(_padded(share.rows, share.width)))
    return taken


def _ids(roster: Roster, shares: Sequence[Share]) -> list[str]:
    """Return the ids of a seat's shares, without padding."""
    return [roster.stacks[share.stack].ids[row] for share in shares for row in share.rows]


def _padded(rows: range, width: int) -> list[int]:
    """Return the rows, the last repeated up to `width`."""
    return [rows[min(i, len(rows) - 1)] for i in range(width)]


def planned_rows(job: Job, tile: Tile) -> pl.DataFrame:
    """Return what is known of a tile's real episodes before they are played.

    Who plays, which episode, from which start: ego by ego, partner by partner.
    """
    e, p, k = tile.played
    egos = _described("ego", job.egos, _ids(job.egos, tile.egos))
    partners = _described("partner", job.partners, _ids(job.partners, tile.partners))
    sides = [job.sides.get(name) for name in partners["partner"]]
    partners = partners.with_columns(pl.Series("side", sides, pl.String))
    episodes = pl.DataFrame({"episode": list(tile.episodes)})
    keys = np.broadcast_to(job.seeds(partners["partner"].to_list(), tile.episodes), (e, p, k))
    if tile.paired:
        rows = pl.concat([egos, partners], how="horizontal")
    else:
        rows = egos.join(partners, how="cross", maintain_order="left_right")
    rows = rows.join(episodes, how="cross", maintain_order="left_right")
    places, wishes = {}, {}
    if job.series > 1:
        played = tile.episodes.start + job.order(partners["partner"].to_list(), k)
        order = {"episode": played, "place": 1 + np.arange(k) % job.series}
        places = {name: np.broadcast_to(one, (e, p, k)).ravel() for name, one in order.items()}
    if job.preferences:
        names = job.wishes(partners["partner"].to_list(), tile.episodes)
        wishes = {"preference": np.broadcast_to(names, (e, p, k)).ravel()}
    return _with(rows, {**places, **wishes, "key": keys.ravel()})


def _rows(job: Job, tile: Tile, tally: Tally, act: Clipping | None) -> pl.DataFrame:
    """Return the real episodes of a tile, as planned and with what was measured."""
    e, p, k = tile.played
    clipped = {}
    if act is not None:
        clipped = {"clipped": act.shares(tally.steps.shape)[:e, :p, :k].ravel()}
    elif any(isinstance(ego, HostEgo) for ego in job.egos.stacks):
        clipped = {"clipped": np.full(e * p * k, None)}
    tally = jax.tree.map(lambda leaf: leaf[:e, :p, :k].reshape(-1), tally)
    touches = {}
    if tally.violated is not None:
        touches = {"contact_peak": tally.contact_peak, "violated": tally.violated}
    measured = {
        "return": tally.returns,
        "discounted_return": tally.discounted,
        **{TERM_PREFIX + name: value for name, value in tally.terms.items()},
        "success": tally.success,
        "force_mean": tally.force_sum / np.maximum(tally.steps, 1),
        "force_peak": tally.force_peak,
        **touches,
        "first_contact": np.where(tally.first_contact > 0, tally.first_contact, tally.steps),
        "distance_mean": tally.distance_sum / np.maximum(tally.steps, 1),
        **{f"{role}_travel": value for role, value in tally.travel.items()},
        "nonfinite": tally.nonfinite,
        "steps": tally.steps,
        **clipped,
    }
    return _with(planned_rows(job, tile), measured)


def _with(rows: pl.DataFrame, columns: Mapping[str, Any]) -> pl.DataFrame:
    """Return rows with columns of the table's types."""
    return rows.with_columns(
        pl.Series(name, value).cast(SCHEMA.get(name, pl.Float32()))
        for name, value in columns.items()
    )


def _described(seat: str, roster: Roster, ids: list[str]) -> pl.DataFrame:
    """Return the columns of a seat, one row a policy."""
    names = {
        seat: "id",
        **{f"{seat}_{name}": name for name in ("team", "algorithm", "disability", "seed")},
    }
    schema = {column: SCHEMA[column] for column in names}
    return pl.DataFrame(
        [[getattr(m, name) for name in names.values()] for m in roster.describe(ids)],
        schema=schema,
        orient="row",
    )
