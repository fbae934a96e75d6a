"""Blocks of a sweep on a real Ray of two CPUs on this machine."""

import os
import sys
from functools import partial
from pathlib import Path

import pytest

from assistax_base import cluster as ray_blocks
from assistax_base.cluster import BlocksFailedError, RayCluster, run_blocks
from assistax_workshop import sweep as sweeps
from assistax_workshop.sweep import run_sweep
from tests.population.toy_env import ToyEnv, match
from tests.workshop.test_sweep import plan


@pytest.fixture(scope="module")
def two_cpus():
    import ray

    # A cluster of this size: only the private name takes the number of cores.
    ray_blocks._connect(ray, None, num_cpus=2)
    yield
    ray.shutdown()


def toy_that_fails_once(marker: Path) -> ToyEnv:
    """Return the toy, but to the first who asks."""
    try:
        marker.touch(exist_ok=False)
    except FileExistsError:
        return ToyEnv(match)
    raise RuntimeError("out of luck\nfor once")


def work(number: int, count: int, folder: Path) -> None:
    """Leave a file; the second block of three loses its worker each time."""
    if (number, count) == (1, 3):
        os._exit(3)
    (folder / str(number)).touch()


@pytest.mark.slow
def test_sweep_continues_after_failure_and_equals_local_one(two_cpus, tmp_path):
    sweep, done = plan(), []
    make_env = partial(toy_that_fails_once, tmp_path / "marker")
    reason = r"1 of 3 blocks failed: block-00\d: RuntimeError: out of luck; finished blocks"
    with pytest.raises(BlocksFailedError, match=reason):
        run_sweep(sweep, make_env, tmp_path / "ray", RayCluster(cpus=1), done.append)
    assert len(done) == 2 and not (tmp_path / "ray" / "sweep.parquet").exists()
    kept = sorted((tmp_path / "ray").glob("block-*/teams.json"))
    assert len(kept) == 2
    written = [path.stat().st_mtime_ns for path in kept]
    on_ray = run_sweep(sweep, make_env, tmp_path / "ray", RayCluster())
    assert [path.stat().st_mtime_ns for path in kept] == written
    local = run_sweep(sweep, partial(ToyEnv, match), tmp_path / "local")
    assert on_ray.equals(local)
    for name in ("sweep.parquet", "preset.json"):
        assert (tmp_path / "ray" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()


@pytest.mark.slow
def test_lost_worker_is_reported_and_others_continue(two_cpus, tmp_path):
    with pytest.raises(BlocksFailedError, match="1 of 3 blocks failed: b1: WorkerCrashedError: "):
        run_blocks(RayCluster(cpus=1), lambda _: ["b0", "b1", "b2"], work, (tmp_path,))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0", "2"]


@pytest.mark.slow
def test_what_a_cluster_can_never_give_is_refused(two_cpus, tmp_path):
    with pytest.raises(ValueError, match=r"has 2 CPUs and 0 GPUs, and a block takes 1 and 0\.5"):
        run_blocks(RayCluster(gpus=0.5), lambda _: ["b0"], work, (tmp_path,))


@pytest.mark.slow
def test_block_without_gpu_takes_whole_machine(two_cpus):
    import ray

    # What a block asks of a machine is seen nowhere else without a cluster of many machines.
    assert ray_blocks._resolved(ray, RayCluster()).cpus == 2
    assert ray_blocks._slots(ray, RayCluster(cpus=0.5)) == 4
    assert ray_blocks._resolved(ray, RayCluster(gpus=0.5)).cpus == 1
    assert ray_blocks._variables(RayCluster(gpus=0.5))["XLA_PYTHON_CLIENT_MEM_FRACTION"] == "0.450"


def test_results_that_are_not_here_are_missed(tmp_path, monkeypatch):
    # The workers wrote to a disk of their own.
    monkeypatch.setattr(sweeps, "run_blocks", lambda *_: None)
    with pytest.raises(ValueError, match="lacks block-000, block-001, block-002 here; write to a"):
        run_sweep(plan(), partial(ToyEnv, match), tmp_path / "ray", RayCluster())


def test_a_cluster_that_does_not_answer_is_named(tmp_path, monkeypatch):
    import ray

    monkeypatch.setattr(ray, "is_initialized", lambda: False)
    monkeypatch.setattr(ray, "shutdown", lambda: None)
    words = r"no Ray cluster answers at '127\.0\.0\.1:1' \(.*refused\); start one"
    with pytest.raises(ValueError, match=words):
        run_blocks(RayCluster("127.0.0.1:1"), lambda _: ["b0"], work, (tmp_path,))


def test_without_ray_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ValueError, match=r"install it with: pip install 'assistax-zoo\[ray\]'"):
        run_blocks(RayCluster(), lambda _: ["b0"], work, (tmp_path,))


@pytest.mark.parametrize(
    "wrong", [{"cpus": -1}, {"cpus": 0}, {"gpus": 1.5}, {"gpus": float("nan")}]
)
def test_a_share_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match="a block takes"):
        RayCluster(**wrong)
