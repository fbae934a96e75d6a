"""On `native` and `fused` no value depends on how a job is cut, ordered, killed or spread."""

import functools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
import polars as pl
import pytest

from assistax_envs import Env, make
from evaluation.cast.roster import registry_roster
from evaluation.play import tiles
from evaluation.play.evaluator import in_order
from evaluation.play.jobs import Job
from evaluation.play.runner import Runner
from evaluation.play.shares import run_share  # noqa: F401 (scripts of subprocesses use it)
from evaluation.play.tiles import plan
from evaluation.record import tables
from population.play import rollout, seats
from tests.evaluation.matrix_game import host
from zoo.registry import load_registry

pytestmark = pytest.mark.usefixtures("optimised")
ROOT = Path(__file__).parents[2]
TILE = 64  # smaller than a user's: three tiles are then quick to play
OURS = ("native", "fused")  # backends whose tiles are the job's own
SIZES = (5, 5, 5)  # egos, partners, episodes: [2, 5, 5] three times, the last one padded


@pytest.fixture(autouse=True)
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "TILE_ENVS", {})
    use_small_tiles()


def use_small_tiles() -> None:
    tiles.TILE_ENVS = dict.fromkeys(OURS, TILE)


@functools.cache
def scratch(length: int, backend: str = "native") -> Env:
    env = make("scratch", backend)
    env.episode_length = length
    return env


def real_job(sizes: tuple[int, int, int] = SIZES, **changes: Any) -> Job:
    registry = load_registry()
    options: dict[str, Any] = {"backend": "native"}
    for seat, role, count in zip(("egos", "partners"), ("robot", "human"), sizes, strict=False):
        chosen = registry.select("scratch/ippo-*", role=role, release="v1")[:count]
        options[seat] = registry_roster(registry, chosen)
    return Job("scratch", 1, episodes=sizes[2], **{**options, **changes})


def played(
    runner: Runner, job: Job, max_envs: int, order: Callable[[list], Sequence] = list
) -> pl.DataFrame:
    """Return the episode table of a job in memory; compiles nothing that `runner` has compiled."""
    parts: list[pl.DataFrame] = []
    runner.run(order(plan(job, max_envs)), lambda chunk, rows: parts.append(rows))
    return in_order(pl.concat(parts), job)


def differing(first: pl.DataFrame, other: pl.DataFrame) -> int:
    """Return how many episodes differ in any value, of those that both tables have."""
    keys = ["ego", "partner", "episode"]
    one = first.join(other, on=keys, how="semi").sort(keys)
    two = other.join(first, on=keys, how="semi").sort(keys)
    assert one.height == two.height > 0
    same = [one[name].eq_missing(two[name]).to_numpy() for name in first.columns]
    return int((~np.all(same, axis=0)).sum())


@pytest.mark.parametrize("backend", OURS)
def test_the_tiles_are_the_jobs_own(backend: str):
    job = real_job(backend=backend)
    cuts = {max_envs: plan(job, max_envs) for max_envs in (1, 130, 2048)}
    tiles = [[tile for chunk in chunks for tile in chunk.tiles] for chunks in cuts.values()]
    assert tiles[0] == tiles[1] == tiles[2]
    assert [len(chunks) for chunks in cuts.values()] == [3, 2, 1]
    assert any(tile.rows < np.prod(tile.shape) for tile in tiles[0])
    assert max(int(np.prod(tile.shape)) for tile in tiles[0]) <= TILE
    assert sum(tile.rows for tile in tiles[0]) == job.rows
    elsewhere = plan(real_job(backend="mjx"), 2048)
    assert [len(chunk.tiles) for chunk in elsewhere] == [1]  # an accelerator wants one large batch


@pytest.mark.slow
@pytest.mark.parametrize("backend", OURS)
def test_neither_chunks_nor_their_order_change_a_value(backend: str):
    job = real_job(backend=backend)
    runner = Runner(scratch(60, backend), job)
    whole = played(runner, job, 2048)
    assert whole.height == job.rows
    assert whole["return"].n_unique() > 0.9 * job.rows
    assert differing(played(runner, job, 1, lambda chunks: chunks[::-1]), whole) == 0
    assert differing(played(runner, job, 130), whole) == 0


@pytest.mark.slow
def test_other_policies_do_not_change_values():
    whole = played(Runner(scratch(200), real_job()), real_job(), 2048)
    for sizes in ((1, 1, 1), (2, 2, 2), (1, 5, 4), (3, 1, 5)):
        job = real_job(sizes)
        assert differing(played(Runner(scratch(200), job), job, 2048), whole) == 0


@pytest.mark.slow
def test_planted_defect_tiles_by_max_envs_are_caught(monkeypatch: pytest.MonkeyPatch):
    """Planted: tiles by `max_envs`, and a program in which XLA fuses as it likes."""
    monkeypatch.setattr(rollout, "trip_count", lambda: None)
    monkeypatch.setattr(seats, "member_map", jax.vmap)
    job = real_job(backend="mjx")
    runner = Runner(scratch(60), job)
    assert differing(played(runner, job, 25), played(runner, job, 2048)) > 0


@pytest.mark.slow
def test_outside_robot_batches_do_not_change():
    sizes: list[int] = []

    def act(obs: np.ndarray) -> np.ndarray:
        sizes.append(len(obs))
        return np.tanh(obs[:, :7])

    job = real_job((1, 30, 5), egos=host(act))
    runner = Runner(scratch(10), job)
    whole = played(runner, job, 2048)
    assert differing(played(runner, job, 1, lambda chunks: chunks[::-1]), whole) == 0
    assert len(set(sizes)) == 1


HEAD = """
import os, signal, sys
from pathlib import Path
import jax
from evaluation.record import tables
from evaluation.play.shares import run_share
from evaluation.play.evaluator import run_job
from tests.evaluation.test_invariance import real_job, scratch, use_small_tiles
use_small_tiles()
folder, env, max_envs = Path(sys.argv[1]), scratch(int(sys.argv[2])), int(sys.argv[3])
"""


WHOLE = "run_job(env, real_job(), folder, max_envs=max_envs)\n"
BLOCKS = """
for i in (3, 2, 1):
    run_share(env, real_job(), folder, (i, 3), max_envs=max_envs)
"""
KILLED = """
write = tables.write_bytes
def deadly(data, path):
    write(data, path)
    if 'part-' in path.name:
        os.kill(os.getpid(), signal.SIGKILL)
tables.write_bytes = deadly
"""
DEVICES = """
devices = jax.local_devices()
assert len(devices) == 2
run_job(env, real_job(), folder, devices=devices, max_envs=max_envs)
"""


@pytest.mark.slow
@pytest.mark.parametrize("length", [100, 1000])
def test_blocks_kills_and_devices_leave_the_same_bytes(tmp_path: Path, length: int):
    def contents(folder: str) -> bytes:
        return (tmp_path / folder / tables.EPISODES_FILE).read_bytes()

    def status(script: str, folder: str, max_envs: int, devices: int = 1) -> int:
        """Run a script as a user would: with XLA's own defaults, not those of tests."""
        flags = f"--xla_force_host_platform_device_count={devices}"
        arguments = map(str, (tmp_path / folder, length, max_envs))
        command = [sys.executable, "-c", HEAD + script, *arguments]
        environment = {**os.environ, "XLA_FLAGS": flags, "PYTHONPATH": str(ROOT)}
        return subprocess.run(command, cwd=ROOT, env=environment, timeout=900).returncode

    assert status(WHOLE, "whole", 2048) == 0
    assert status(BLOCKS + WHOLE, "blocks", 1) == 0
    assert status(KILLED + WHOLE, "killed", 130) == -signal.SIGKILL
    assert status(WHOLE, "killed", 130) == 0
    assert status(DEVICES, "devices", 1, devices=2) == 0
    for folder in ("blocks", "killed", "devices"):
        assert contents(folder) == contents("whole")
