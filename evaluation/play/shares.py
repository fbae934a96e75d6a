"""Run a job in shares of its chunks: one share a command, or spread over a Ray cluster."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from assistax_base.cluster import NOT_SHARED, RayCluster, run_blocks
from assistax_base.locks import LOCK_FILE, locked
from evaluation.play.evaluator import (
    MAX_ENVS,
    check_folder,
    check_sizes,
    is_finished,
    open_folder,
    plan_of,
    simulate,
)
from evaluation.play.jobs import Job
from evaluation.play.parts import PARTS_FOLDER, find_part
from evaluation.play.progress import OnProgress, Progress
from evaluation.play.tiles import Chunk, plan
from evaluation.record import manifest as provenance


@dataclasses.dataclass(frozen=True)
class ShareDone:
    """A finished share of a job."""

    share: str  # such as "2/4"
    chunks: int  # number of chunks of this share
    episodes: int
    all_chunks: int  # of the whole job
    missing: int  # chunks of the whole job that the folder still lacks


def run_share(
    env: Any,
    job: Job,
    folder: Path,
    share: tuple[int, int],
    *,
    max_envs: int | None = None,
    on_progress: OnProgress = None,
) -> ShareDone:
    """Simulate the chunks of share (i, n), i from 1, and write their parts to the folder.

    Shares may use one folder or a folder each, also on other machines. All shares must have the
    same `max_envs`: other chunks' parts are not used. If the parts of all shares are in one folder,
    `run_job` merges them without simulating.
    """
    number, count = share
    if not 1 <= number <= count:
        raise ValueError(f"share is {number}/{count}; allowed are 1/{count} to {count}/{count}")
    check_sizes(env, job)
    check_folder(folder)
    own_lock = f"{LOCK_FILE}-{number}-of-{count}"
    with locked(folder, shared=True), locked(folder / PARTS_FOLDER, own_lock):
        chunks = open_folder(folder, job, max_envs or MAX_ENVS[job.backend])
        mine, key = chunks[number - 1 :: count], job.digest()
        if not is_finished(folder):
            left = [chunk for chunk in mine if not find_part(folder, chunk, key)]
            simulate(env, job, folder, left, on_progress=on_progress)
        missing = sum(not find_part(folder, chunk, key) for chunk in chunks)
    done = f"{number}/{count}"
    return ShareDone(done, len(mine), sum(chunk.rows for chunk in mine), len(chunks), missing)


def run_blocks_on_ray(
    make_env: Callable[[], Any],
    job: Job,
    folder: Path,
    cluster: RayCluster,
    *,
    max_envs: int | None = None,
    on_progress: OnProgress = None,
) -> None:
    """Simulate the chunks that a folder lacks on a cluster; `run_job` then merges them.

    There are as many blocks as the cluster runs at once, but not more than chunks.

    Args:
        make_env: Makes the environment of the job, on each worker.
        job: The job to simulate; its robots are all of the zoo.
        folder: The folder of the parts, shared by all machines under the same path.
        cluster: The cluster on which blocks run.
        max_envs: As in `run_job`.
        on_progress: Called with the progress after each block.

    Raises:
        BlocksFailedError: Blocks failed; finished chunks are kept.
        ValueError: The cluster cannot run the blocks, or their parts are not in the folder.
    """
    folder = folder.absolute()
    if is_finished(folder):
        return
    chunks, length = plan(job, max_envs or MAX_ENVS[job.backend]), make_env().episode_length
    began, done, count = time.perf_counter(), 0, 0

    def names(slots: int) -> list[str]:
        nonlocal count
        count = min(slots, len(chunks))
        return [f"block {number + 1}/{count}" for number in range(count)]

    def advance(number: int) -> None:
        nonlocal done
        done += sum(chunk.rows for chunk in chunks[number::count])
        if on_progress is not None:
            on_progress(Progress(done * length, job.rows * length, time.perf_counter() - began))

    run_blocks(cluster, names, _run_remotely, (make_env, job, folder, max_envs), advance)
    _check_parts(job, folder, chunks)


def _run_remotely(
    number: int,
    count: int,
    make_env: Callable[[], Any],
    job: Job,
    folder: Path,
    max_envs: int | None,
) -> None:
    run_share(make_env(), job, folder, (number + 1, count), max_envs=max_envs)


def _check_parts(job: Job, folder: Path, planned: list[Chunk]) -> None:
    """Check that all parts are in the folder here, so that nothing is simulated a second time."""
    manifest = provenance.read_manifest(folder)
    chunks = plan_of(job, manifest) if manifest else planned
    count = sum(find_part(folder, chunk, job.digest()) is not None for chunk in chunks)
    if count < len(chunks):
        raise ValueError(
            f"the workers are done, but {folder} has {count} of {len(chunks)} parts here; "
            f"{NOT_SHARED}"
        )
