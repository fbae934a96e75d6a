"""The chunks of a job spread over a Ray cluster, as blocks whose workers write into one folder."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from evaluation import tables
from evaluation.evaluator import MANIFEST_FILE, MAX_ENVS, PARTS_FOLDER, Progress, run_block
from evaluation.jobs import Job, plan
from population.engines import NOT_SHARED, RayCluster, run_blocks


def run_blocks_on_ray(
    make_env: Callable[[], Any],
    job: Job,
    folder: Path,
    cluster: RayCluster,
    *,
    max_envs: int | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> None:
    """Simulate the chunks that a folder lacks on a cluster; `run_job` then merges them as if they came from one run.

    There are as many blocks as the cluster runs at once, and no more than chunks.

    Args:
        make_env: Makes the environment of the job, on each worker.
        job: What is simulated; its robots are all of the zoo.
        folder: Where the parts are kept: shared by all machines, under the same path.
        cluster: Where blocks run.
        max_envs: As in `run_job`.
        on_progress: Told how far the run is, block by block.

    Raises:
        BlocksFailedError: Blocks failed; the chunks that are finished are kept.
        ValueError: The cluster cannot run them, or they are not in the folder.
    """
    folder = folder.absolute()
    if (folder / tables.EPISODES_FILE).is_file():
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
    _check_parts(job, folder)


def _run_remotely(
    number: int,
    count: int,
    make_env: Callable[[], Any],
    job: Job,
    folder: Path,
    max_envs: int | None,
) -> None:
    run_block(make_env(), job, folder, (number + 1, count), max_envs=max_envs)


def _check_parts(job: Job, folder: Path) -> None:
    """Check that what the workers wrote can be read here: it is not simulated a second time."""
    manifest = folder / MANIFEST_FILE
    wanted = (
        len(plan(job, int(tables.read_json(manifest)["max_envs"]))) if manifest.is_file() else 1
    )
    found = len(list((folder / PARTS_FOLDER).glob("part-*.parquet")))
    if found < wanted:
        raise ValueError(
            f"the workers are done, but {folder} has {found} of {wanted} parts here; {NOT_SHARED}"
        )
