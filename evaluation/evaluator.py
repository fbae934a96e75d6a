"""Run a job chunk by chunk into a folder: resumable, and the table does not depend on how it was cut.

The folder holds `manifest.json` (the job, by its hash, and the plan's size), one Parquet part for
each finished chunk, and at the end `episodes.parquet` in their place.
"""

import dataclasses
import math
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import polars as pl

from evaluation import tables
from evaluation.jobs import Chunk, HostEgo, Job, plan
from evaluation.locks import LOCK_FILE, locked
from evaluation.runner import Meter, Progress, Runner

MANIFEST_FILE = "manifest.json"
PARTS_FOLDER = "parts"
MAX_ENVS = {
    "native": 2048,
    "mjx": 16384,
    "mjx-warp": 32768,
}  # default bound of a chunk's simulations


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """A finished job."""

    table: pl.DataFrame  # one row an episode, in the job's order of egos, partners and episodes
    env_steps_per_second: (
        float | None
    )  # padding and compilation not counted; None where everything was found finished
    compile_seconds: float


@dataclasses.dataclass(frozen=True)
class BlockDone:
    """A finished block of a job."""

    chunks: int  # of this block
    episodes: int
    all_chunks: int  # of the whole job
    missing: int  # chunks of the whole job that the folder still lacks


def run_job(
    env: Any,
    job: Job,
    folder: Path,
    *,
    max_envs: int | None = None,
    wait: bool = False,
    devices: Sequence[jax.Device] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Evaluation:
    """Evaluate every ego with every partner and write `episodes.parquet`.

    A folder of the same job is continued where it stopped, cut as it was begun; its table is that
    of a single run.

    Args:
        env: The environment.
        job: What is evaluated.
        folder: For the table.
        max_envs: Most simulations in a chunk; if not given, that of `MAX_ENVS`, or fewer to have
            one for each device.
        wait: Wait for another process that writes to the folder; else refuse.
        devices: Where to simulate; all of this process if not given.
        on_progress: Told how far the run is.

    Raises:
        ValueError: the folder holds another job, or a policy reads other observations than the task
            gives.
        EgoError: a robot from outside failed; finished chunks are kept.
    """
    check_sizes(env, job)
    check_folder(folder)
    if max_envs is None:
        share = math.ceil(job.rows / len(devices or jax.local_devices()))
        max_envs = min(share, MAX_ENVS[job.backend])
    with locked(folder, wait=wait):
        return _run_and_merge(env, job, folder, max_envs, devices, on_progress)


def run_block(
    env: Any,
    job: Job,
    folder: Path,
    block: tuple[int, int],
    *,
    max_envs: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> BlockDone:
    """Simulate the chunks of block (i, n), i from 1, and leave their parts in the folder.

    Blocks may share a folder or have one each, also on other machines; they must be cut alike, by
    the same `max_envs`. With the parts of all blocks in one folder, `run_job` merges them without
    simulating anything.
    """
    number, count = block
    if not 1 <= number <= count:
        raise ValueError(f"block is {number}/{count}; allowed are 1/{count} to {count}/{count}")
    check_sizes(env, job)
    check_folder(folder)
    own_lock = f"{LOCK_FILE}-{number}-of-{count}"
    with locked(folder, shared=True), locked(folder / PARTS_FOLDER, own_lock):
        chunks = plan(job, _open_folder(folder, job, max_envs or MAX_ENVS[job.backend]))
        mine = chunks[number - 1 :: count]
        if not (folder / tables.EPISODES_FILE).is_file():
            _simulate(
                env,
                job,
                folder,
                [chunk for chunk in mine if not _is_done(folder, chunk)],
                None,
                on_progress,
            )
        missing = sum(not _is_done(folder, chunk) for chunk in chunks)
    return BlockDone(len(mine), sum(chunk.rows for chunk in mine), len(chunks), missing)


def _run_and_merge(
    env: Any,
    job: Job,
    folder: Path,
    max_envs: int,
    devices: Sequence[jax.Device] | None,
    on_progress: Callable[[Progress], None] | None,
) -> Evaluation:
    chunks = plan(job, _open_folder(folder, job, max_envs))
    target = folder / tables.EPISODES_FILE
    missing = [] if target.is_file() else [chunk for chunk in chunks if not _is_done(folder, chunk)]
    speed, compile_seconds = _simulate(env, job, folder, missing, devices, on_progress)
    if not target.is_file():
        parts = pl.concat([pl.read_parquet(_part(folder, chunk)) for chunk in chunks])
        tables.write_episodes(_in_order(parts, job), target)
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
    return Evaluation(tables.read_episodes(target), speed, compile_seconds)


def _simulate(
    env: Any,
    job: Job,
    folder: Path,
    chunks: list[Chunk],
    devices: Sequence[jax.Device] | None,
    on_progress: Callable[[Progress], None] | None,
) -> tuple[float | None, float]:
    """Run chunks, leaving each one's part in the folder; return env steps per second and the compilation's seconds."""
    meter = Meter(sum(chunk.rows for chunk in chunks) * env.episode_length, on_progress)
    meter.report()
    runner = Runner(env, job, devices)
    runner.run(chunks, lambda chunk, rows: tables.write_parquet(rows, _part(folder, chunk)), meter)
    return meter.speed, runner.compile_seconds


def check_sizes(env: Any, job: Job) -> None:
    """Refuse policies whose seat, observations or actions are not this task's."""
    for seat, part, groups in (("robot", "ego", job.egos), ("human", "partner", job.partners)):
        for group in groups:
            if isinstance(group, HostEgo):
                continue
            spec, name = group.spec, group.members[0].id
            if spec.role != seat:
                raise ValueError(f"{name} is a {spec.role} policy; the {part} is the {seat}")
            for what, found, expected in (
                ("reads observations of", spec.observation_size, env.observation_size[seat]),
                ("gives actions of", spec.action_size, env.action_size[seat]),
            ):
                if found != expected:
                    raise ValueError(
                        f"{name} {what} {found} numbers; the {seat} of task {job.task} has "
                        f"{expected}: it was made for another task, choose a policy of this one "
                        "(`assistax-zoo list`)"
                    )


def check_folder(folder: Path) -> None:
    """Create an output folder, and find out now, not after the run, that it cannot be written."""
    try:
        with tables.atomic_path(folder / "writable.tmp") as probe:
            probe.write_bytes(b"")
        (folder / "writable.tmp").unlink(missing_ok=True)  # another block may have been quicker
    except OSError as error:
        raise OSError(
            f"cannot write to {folder} ({error.strerror or error}); choose another --out"
        ) from error


def _open_folder(folder: Path, job: Job, max_envs: int) -> int:
    """Begin or continue the folder's job; return the size its plan was begun with."""
    path = folder / MANIFEST_FILE
    found = tables.read_json(path) if path.is_file() else None
    if found is None:
        if (folder / tables.EPISODES_FILE).exists():
            raise ValueError(
                f"{folder} holds {tables.EPISODES_FILE} without {MANIFEST_FILE}; choose another "
                "--out"
            )
        return _begin(path, job, max_envs)
    if found.get("job") != job.digest():
        identity = job.identity()
        differing = [name for name in identity if found.get(name) != identity[name]]
        raise ValueError(
            f"{folder} holds another job ({_difference(found, identity, differing)}); choose "
            "another --out or delete it"
        )
    if not any((folder / PARTS_FOLDER).glob("part-*")):
        return _begin(path, job, max_envs)
    return int(found["max_envs"])


def _begin(path: Path, job: Job, max_envs: int) -> int:
    tables.write_json({"job": job.digest(), "max_envs": max_envs, **job.identity()}, path)
    return max_envs


def _difference(found: dict[str, Any], expected: dict[str, Any], names: list[str]) -> str:
    told = []
    for name in names:
        here, there = expected[name], found.get(name)
        told.append(
            f"other {name}"
            if isinstance(here, (list, dict))
            else f"{name} {there} there, {here} here"
        )
    return ", ".join(told) or "a different hash"


def _in_order(table: pl.DataFrame, job: Job) -> pl.DataFrame:
    """Sort by the job's order, so that neither chunks nor resuming show."""
    for seat, groups in (("ego", job.egos), ("partner", job.partners)):
        ids = [member.id for group in groups for member in group.members]
        rank = pl.Series(range(len(ids)), dtype=pl.Int64)
        table = table.with_columns(pl.col(seat).replace_strict(ids, rank).alias(f"_{seat}"))
    return table.sort("_ego", "_partner", "episode").drop("_ego", "_partner")


def _part(folder: Path, chunk: Chunk) -> Path:
    return folder / PARTS_FOLDER / f"part-{chunk.index:05d}.parquet"


def _is_done(folder: Path, chunk: Chunk) -> bool:
    """Return whether a chunk's part is there and whole; a damaged one is simulated again."""
    path = _part(folder, chunk)
    if not path.is_file():
        return False
    try:
        return pl.read_parquet(path, columns=["key"]).height == chunk.rows
    except pl.exceptions.PolarsError:
        return False
