"""Run a job chunk by chunk into a folder. A stopped run can be continued.

The folder holds `manifest.json` (see `evaluation.record.manifest`) and one Parquet part for each
finished chunk (see `evaluation.play.parts`). At the end `episodes.parquet` replaces the parts. Its
content does not depend on the chunks. Damaged parts and tables are simulated again.
"""

import dataclasses
import errno
import math
import shutil
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import polars as pl

from assistax_base.errors import AdvisedError
from assistax_base.locks import locked
from evaluation.cast.roster import check_seat
from evaluation.play.jobs import Job
from evaluation.play.parts import (
    PARTS_FOLDER,
    check_parts,
    find_part,
    has_parts,
    label,
    merge_parts,
    write_part,
)
from evaluation.play.progress import Meter, OnProgress
from evaluation.play.robot_checks import changed_file, note_files
from evaluation.play.runner import Runner, devices_for
from evaluation.play.tiles import Chunk, plan, tile_envs
from evaluation.record import manifest as provenance
from evaluation.record import tables
from evaluation.record.manifest import MANIFEST_FILE

# Default bound of a chunk's simulations.
MAX_ENVS = {"native": 2048, "fused": 32768, "mjx": 16384, "mjx-warp": 32768}


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """A finished job."""

    table: pl.DataFrame  # one row an episode, in the job's order of egos, partners and episodes
    # Without padding and compilation; None if nothing had to be simulated.
    env_steps_per_second: float | None
    compile_seconds: float


def run_job(
    env: Any,
    job: Job,
    folder: Path,
    *,
    max_envs: int | None = None,
    reuse: bool = False,
    kept: bool = False,
    devices: Sequence[jax.Device] | None = None,
    on_progress: OnProgress = None,
) -> Evaluation:
    """Play every ego with every partner, write `episodes.parquet`, and return the evaluation.

    A folder of the same job is continued with the chunks that it was begun with. Its table is equal
    to that of a single run.

    Args:
        env: The environment.
        job: The job to play.
        folder: The folder for the table.
        max_envs: Most simulations in a chunk. By default that of `MAX_ENVS`, or fewer to have one
            chunk for each device.
        reuse: Accept existing episodes of a robot of code with undeclared dependencies, which
            may have changed.
        kept: Whether the folder is a cache's. If so, wait for another process that writes to it,
            and start again if it is damaged or of such a robot; else refuse all three.
        devices: Devices to simulate on; by default `evaluation.play.runner.devices_for`.
        on_progress: Called with the progress of the run.

    Raises:
        ValueError: The folder holds another job, or one of a robot that may have changed, or a
            policy does not fit the task.
        EgoError: A robot from outside failed; finished chunks are kept.
    """
    check_sizes(env, job)
    check_folder(folder)
    if max_envs is None:
        share = math.ceil(job.rows / len(devices or devices_for(job.rows)))
        max_envs = min(share, MAX_ENVS[job.backend])
    with locked(folder, wait=kept):
        if kept and not (job.reusable and provenance.is_readable(folder)):
            delete_results(folder)
        if kept:
            _check_kept(folder, job)
        _check_reusable(folder, job, reuse)
        return _run_and_merge(env, job, folder, max_envs, devices, on_progress)


def check_sizes(env: Any, job: Job) -> None:
    """Raise a ValueError if a policy does not fit the role, observations or actions of its seat."""
    for role, roster in (("robot", job.egos), ("human", job.partners)):
        for stack in roster.policies:
            check_seat(stack.ids[0], stack.spec, role, env, job.task)


def check_folder(folder: Path, advice: str = "choose another folder") -> None:
    """Create a folder, and raise an OSError before a run if it cannot be written."""
    probe = folder / f".writable-{uuid.uuid4().hex[:8]}"
    try:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "it is not a folder")
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise OSError(f"cannot write to {folder} ({error.strerror or error}); {advice}") from error


def clear_results(env: Any, job: Job, folder: Path) -> None:
    """Remove a folder's job and its results, after checking that `job` can replace it.

    Raises:
        ValueError: A policy does not fit the task, or another process writes to the folder.
    """
    check_sizes(env, job)
    with locked(folder):
        delete_results(folder)


def delete_results(folder: Path) -> None:
    """Remove a folder's parts, tables, figures and manifest; files of other names stay."""
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
    for name in (*tables.FILES, MANIFEST_FILE):
        (folder / name).unlink(missing_ok=True)


def open_folder(folder: Path, job: Job, max_envs: int) -> list[Chunk]:
    """Start or continue a folder's job; return its chunks, cut as when the folder was started.

    Raises:
        AdvisedError: The folder holds another job.
        ValueError: It holds tables without a manifest.
    """
    manifest = provenance.read_manifest(folder)
    if manifest is None:
        if (folder / tables.EPISODES_FILE).exists():
            raise ValueError(
                f"{folder} holds {tables.EPISODES_FILE} without {MANIFEST_FILE}; choose another "
                "folder"
            )
    elif manifest.get("job") != job.digest():
        difference = _difference(manifest.get("identity", {}), job.identity())
        raise AdvisedError(
            f"{folder} holds another job ({difference}); choose another folder, or replace it",
            "replace the job",
        )
    check_parts(folder, job.digest())
    if manifest and (is_finished(folder) or has_parts(folder)):
        return plan_of(job, manifest)
    manifest = {
        "job": job.digest(),
        "identity": job.identity(),
        "max_envs": max_envs,
        "tile_envs": tile_envs(job.backend, max_envs),
    }
    provenance.write_manifest(folder, manifest)
    return plan_of(job, manifest)


def plan_of(job: Job, manifest: Mapping[str, Any]) -> list[Chunk]:
    """Return a job's chunks with the sizes in its manifest, which another machine may have set."""
    return plan(job, int(manifest["max_envs"]), int(manifest["tile_envs"]))


def is_finished(folder: Path) -> bool:
    """Return whether the folder has a table of episodes with the hash in its manifest."""
    return provenance.has_whole(folder, tables.EPISODES_FILE)


def simulate(
    env: Any,
    job: Job,
    folder: Path,
    chunks: Sequence[Chunk],
    devices: Sequence[jax.Device] | None = None,
    on_progress: OnProgress = None,
) -> tuple[float | None, float]:
    """Simulate chunks and write a part for each.

    Return environment steps per second (None without chunks) and the seconds of compilation.
    """
    meter = Meter(sum(chunk.rows for chunk in chunks) * env.episode_length, on_progress)
    meter.report()
    runner = Runner(env, job, devices)
    metadata = label(job.digest())

    def save(chunk: Chunk, rows: pl.DataFrame) -> None:
        # Checked first, so that no part is of a robot that changed.
        note_files(folder, job.egos)
        write_part(rows, folder, chunk, metadata)

    runner.run(chunks, save, meter)
    return meter.speed, runner.compile_seconds


def in_order(table: pl.DataFrame, job: Job) -> pl.DataFrame:
    """Return the table in the job's order of egos, partners and episodes, whatever its chunks."""
    for seat, roster in (("ego", job.egos), ("partner", job.partners)):
        rank = pl.Series(range(len(roster.ids)), dtype=pl.Int64)
        rows = pl.col(seat).replace_strict(list(roster.ids), rank)
        table = table.with_columns(rows.alias(f"_{seat}"))
    return table.sort("_ego", "_partner", "episode").drop("_ego", "_partner")


def _run_and_merge(
    env: Any,
    job: Job,
    folder: Path,
    max_envs: int,
    devices: Sequence[jax.Device] | None,
    on_progress: OnProgress,
) -> Evaluation:
    chunks, target = open_folder(folder, job, max_envs), folder / tables.EPISODES_FILE
    finished, key = is_finished(folder), job.digest()
    missing = [] if finished else [chunk for chunk in chunks if not find_part(folder, chunk, key)]
    speed, compile_seconds = simulate(env, job, folder, missing, devices, on_progress)
    if not finished:
        parts = [path for chunk in chunks if (path := find_part(folder, chunk, key))]
        merged, machine = merge_parts(parts)
        tables.write_episodes(in_order(merged, job), target)
        # Tables and figures of earlier episodes.
        tables.remove_derived(folder)
        provenance.seal(folder, made_with=machine)
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
    return Evaluation(tables.read_episodes(target), speed, compile_seconds)


def _check_reusable(folder: Path, job: Job, reuse: bool) -> None:
    """Raise an AdvisedError if a folder's episodes are of a robot that may have changed since."""
    began = (folder / tables.EPISODES_FILE).exists() or has_parts(folder)
    if reuse or not began:
        return
    if (provenance.read_manifest(folder) or {}).get("job") != job.digest():
        # Another job is refused later, with a message of its own.
        return
    advice, remedy = "reuse them, replace them, or choose another folder", "reuse or replace"
    if changed := changed_file(folder):
        robot, path = changed
        raise AdvisedError(
            f"{folder} holds episodes of {robot}, which loaded {path} while it played, and that "
            f"file is another one now; {advice}",
            remedy,
        )
    if job.reusable:
        return
    unsure = next(name for name in job.egos.ids if not job.egos.members[name].reusable)
    raise AdvisedError(
        f"{folder} holds episodes of {unsure}, and nothing says whether that is still the same "
        f"robot; {advice}",
        remedy,
    )


def _check_kept(folder: Path, job: Job) -> None:
    """Raise a ValueError if a cache's folder holds another job than its name says."""
    stored = (provenance.read_manifest(folder) or {}).get("job", job.digest())
    if stored != job.digest():
        raise ValueError(
            f"the kept episodes in {folder} are of another job; remove that folder, and they are "
            "played again"
        )


def _difference(identity: dict[str, Any], expected: dict[str, Any]) -> str:
    differences = []
    for name, here in expected.items():
        there = identity.get(name)
        if there != here:
            simple = not isinstance(here, (list, dict))
            differences.append(f"{name} {there} there, {here} here" if simple else f"other {name}")
    return ", ".join(differences) or "a different hash"
