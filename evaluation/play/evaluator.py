"""Run a job chunk by chunk into a folder.

Resumable, and the table does not depend on how it was cut.

The folder holds `manifest.json` (see `evaluation.record.manifest`), one Parquet part for each
finished chunk (see `evaluation.play.parts`), and at the end `episodes.parquet` in their place. A
damaged part is simulated again, and so is a finished table.
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
    # Padding and compilation not counted; None where everything was found finished.
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
    """Evaluate every ego with every partner and write `episodes.parquet`.

    A folder of the same job is continued where it stopped, cut as it was begun; its table is that
    of a single run.

    Args:
        env: The environment.
        job: What is evaluated.
        folder: For the table.
        max_envs: Most simulations in a chunk; if not given, that of `MAX_ENVS`, or fewer to have
            one for each device.
        reuse: Take what the folder holds though a robot is code whose dependencies nobody declared;
            else it is refused.
        kept: The folder is a cache's: wait for another process that writes to it, and begin anew
            where it is damaged or of such a robot; else all three are refused.
        devices: Where to simulate; see `evaluation.play.runner.devices_for` if not given.
        on_progress: Told how far the run is.

    Raises:
        ValueError: the folder holds another job, or one of a robot that may have changed, or a
            policy reads other observations than the task gives.
        EgoError: a robot from outside failed; finished chunks are kept.
    """
    check_sizes(env, job)
    check_folder(folder)
    if max_envs is None:
        share = math.ceil(job.rows / len(devices or devices_for(job.rows)))
        max_envs = min(share, MAX_ENVS[job.backend])
    with locked(folder, wait=kept):
        if kept and not (job.reusable and provenance.is_readable(folder)):
            forget(folder)
        if kept:
            _check_kept(folder, job)
        _check_reusable(folder, job, reuse)
        return _run_and_merge(env, job, folder, max_envs, devices, on_progress)


def check_sizes(env: Any, job: Job) -> None:
    """Refuse policies whose seat, observations or actions are not this task's."""
    for role, roster in (("robot", job.egos), ("human", job.partners)):
        for stack in roster.policies:
            check_seat(stack.ids[0], stack.spec, role, env, job.task)


def check_folder(folder: Path, advice: str = "choose another folder") -> None:
    """Create a folder, and find out now, not after the run, that it cannot be written."""
    probe = folder / f".writable-{uuid.uuid4().hex[:8]}"
    try:
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "it is not a folder")
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise OSError(f"cannot write to {folder} ({error.strerror or error}); {advice}") from error


def make_way(env: Any, job: Job, folder: Path) -> None:
    """Remove whatever job a folder holds, and all that was drawn from it, for one that can be run.

    Raises:
        ValueError: a policy is not this task's, or another process writes to the folder.
    """
    check_sizes(env, job)
    with locked(folder):
        forget(folder)


def forget(folder: Path) -> None:
    """Remove what a folder holds of a job, and all that was drawn from it; other files stay."""
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
    for name in (*tables.FILES, MANIFEST_FILE):
        (folder / name).unlink(missing_ok=True)


def open_folder(folder: Path, job: Job, max_envs: int) -> list[Chunk]:
    """Begin or continue the folder's job; return its plan, cut as it was begun."""
    manifest = provenance.read_manifest(folder)
    if manifest is None:
        if (folder / tables.EPISODES_FILE).exists():
            raise ValueError(
                f"{folder} holds {tables.EPISODES_FILE} without {MANIFEST_FILE}; choose another "
                "folder"
            )
    elif manifest.get("job") != job.digest():
        difference = _difference(manifest.get("identity", {}), job.identity())
        raise ValueError(
            f"{folder} holds another job ({difference}); choose another folder, or replace it "
            "(replace)"
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
    """Return a job's plan as it was cut where its folder was begun: a GPU's tiles are larger."""
    return plan(job, int(manifest["max_envs"]), int(manifest["tile_envs"]))


def is_finished(folder: Path) -> bool:
    """Return whether the folder's table is there, with the hash that its manifest holds."""
    return provenance.has_whole(folder, tables.EPISODES_FILE)


def simulate(
    env: Any,
    job: Job,
    folder: Path,
    chunks: Sequence[Chunk],
    devices: Sequence[jax.Device] | None = None,
    on_progress: OnProgress = None,
) -> tuple[float | None, float]:
    """Run chunks, leaving each one's part.

    Return env steps per second and compilation's seconds.
    """
    meter = Meter(sum(chunk.rows for chunk in chunks) * env.episode_length, on_progress)
    meter.report()
    runner = Runner(env, job, devices)
    said = label(job.digest())

    def save(chunk: Chunk, rows: pl.DataFrame) -> None:
        note_files(folder, job.egos)  # before: a part is of robots that did not change
        write_part(rows, folder, chunk, said)

    runner.run(chunks, save, meter)
    return meter.speed, runner.compile_seconds


def in_order(table: pl.DataFrame, job: Job) -> pl.DataFrame:
    """Sort by the job's order, so that neither chunks nor resuming show."""
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
        tables.remove_derived(folder)  # of what was there before
        provenance.seal(folder, made_with=machine)
    shutil.rmtree(folder / PARTS_FOLDER, ignore_errors=True)
    return Evaluation(tables.read_episodes(target), speed, compile_seconds)


def _check_reusable(folder: Path, job: Job, reuse: bool) -> None:
    """Refuse episodes of a robot of this name that may since be another one."""
    began = (folder / tables.EPISODES_FILE).exists() or has_parts(folder)
    if reuse or not began:
        return
    if (provenance.read_manifest(folder) or {}).get("job") != job.digest():
        return  # another job, which is refused as such
    choices = "take them as they are (reuse), replace them (replace), or choose another folder"
    if changed := changed_file(folder):
        robot, path = changed
        raise ValueError(
            f"{folder} holds episodes of {robot}, which loaded {path} while it played, and that "
            f"file is another one now; {choices}"
        )
    if job.reusable:
        return
    unsure = next(name for name in job.egos.ids if not job.egos.members[name].reusable)
    raise ValueError(
        f"{folder} holds episodes of {unsure}, and nothing says whether that is still the same "
        f"robot; {choices}"
    )


def _check_kept(folder: Path, job: Job) -> None:
    """Refuse a cache's folder that holds another job than its name says."""
    there = (provenance.read_manifest(folder) or {}).get("job", job.digest())
    if there != job.digest():
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
