"""Blocks of a job on several hosts, and several processes on one folder."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from assistax_base.locks import locked
from evaluation.play.evaluator import run_job
from evaluation.play.parts import PARTS_FOLDER
from evaluation.play.shares import run_share
from evaluation.record import tables
from tests.evaluation.matrix_game import MatrixGame
from tests.evaluation.test_evaluator import make_job, mixed_job

ROOT = Path(__file__).parents[2]


def test_blocks_merge_to_single_run_table(tmp_path: Path):
    job, whole = mixed_job(), run_job(MatrixGame(), mixed_job(), tmp_path / "whole", max_envs=7)
    hosts = [tmp_path / f"host{i}" for i in range(3)]
    done = [run_share(MatrixGame(), job, hosts[i], (i + 1, 3), max_envs=7) for i in (2, 0, 1)]
    assert sum(share.chunks for share in done) == done[0].all_chunks
    assert sum(share.episodes for share in done) == job.rows
    assert all(share.missing == share.all_chunks - share.chunks for share in done)
    for host in hosts[1:]:
        shutil.copytree(host / PARTS_FOLDER, hosts[0] / PARTS_FOLDER, dirs_exist_ok=True)
    merged = run_job(MatrixGame(), job, hosts[0], max_envs=7)
    assert merged.env_steps_per_second is None  # nothing was simulated again
    assert (hosts[0] / tables.EPISODES_FILE).read_bytes() == (
        tmp_path / "whole" / tables.EPISODES_FILE
    ).read_bytes()
    assert merged.table.equals(whole.table)


def test_parts_of_another_cut_are_not_taken(tmp_path: Path):
    """As of a machine with a GPU, whose tiles are larger, or of another --max-envs."""
    job, whole = mixed_job(), run_job(MatrixGame(), mixed_job(), tmp_path / "whole", max_envs=7)
    hosts = tmp_path / "host1", tmp_path / "host2"
    for i, (host, max_envs) in enumerate(zip(hosts, (7, 4), strict=True)):
        run_share(MatrixGame(), job, host, (i + 1, 2), max_envs=max_envs)
    shutil.copytree(hosts[1] / PARTS_FOLDER, hosts[0] / PARTS_FOLDER, dirs_exist_ok=True)
    merged = run_job(MatrixGame(), job, hosts[0], max_envs=7)
    assert merged.env_steps_per_second is not None  # what block 2 should have brought
    assert merged.table.equals(whole.table)


def test_blocks_may_share_a_folder(tmp_path: Path):
    job = make_job()
    first, second = (run_share(MatrixGame(), job, tmp_path, (i, 2), max_envs=3) for i in (1, 2))
    assert (first.missing, second.missing) == (first.all_chunks - first.chunks, 0)
    assert run_job(MatrixGame(), job, tmp_path).table.height == job.rows
    # The folder is merged, so nothing is simulated.
    assert run_share(MatrixGame(), job, tmp_path, (1, 2), max_envs=3).chunks == first.chunks
    for share in ((0, 2), (3, 2)):
        with pytest.raises(ValueError, match="allowed are 1/2 to 2/2"):
            run_share(MatrixGame(), job, tmp_path, share)


def test_a_folder_has_one_writer(tmp_path: Path):
    with locked(tmp_path):
        for run in (run_job, lambda *args: run_share(*args, (1, 2))):
            with pytest.raises(ValueError, match=r"another process is writing to .*; wait until"):
                run(MatrixGame(), make_job(), tmp_path)
    with (
        locked(tmp_path, shared=True),
        locked(tmp_path, shared=True),
        pytest.raises(ValueError, match="another"),
    ):
        run_job(MatrixGame(), make_job(), tmp_path)
    assert run_job(MatrixGame(), make_job(), tmp_path).table.height == make_job().rows


def test_a_lock_ends_with_its_process(tmp_path: Path):
    script = (
        "import sys, time\nfrom pathlib import Path\nfrom assistax_base.locks import locked\n"
        "with locked(Path(sys.argv[1])):\n    print('held', flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(ValueError, match="another process"), locked(tmp_path):
            pass
        holder.kill()
        with locked(tmp_path, wait=True):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_killed_run_resumes_to_same_bytes(tmp_path: Path, seed: int):
    """SIGKILL from outside, at a moment drawn between the first part and the last."""
    script = (
        "import sys\nfrom pathlib import Path\n"
        "from evaluation.play.evaluator import run_job\n"
        "from tests.evaluation.matrix_game import MatrixGame\n"
        "from tests.evaluation.test_evaluator import mixed_job\n"
        "run_job(MatrixGame(), mixed_job(), Path(sys.argv[1]), max_envs=2)\n"
    )
    rng, folder = np.random.default_rng(seed), tmp_path / "killed"
    count = int(rng.integers(1, 20))
    with subprocess.Popen([sys.executable, "-c", script, str(folder)], cwd=ROOT) as process:
        while process.poll() is None and len(list((folder / PARTS_FOLDER).glob("part-*"))) < count:
            time.sleep(0.001)
        time.sleep(rng.uniform(0, 0.01))
        process.kill()  # on a busy machine the run may have ended meanwhile
    resumed = run_job(MatrixGame(), mixed_job(), folder)
    whole = run_job(MatrixGame(), mixed_job(), tmp_path / "whole", max_envs=1000)
    assert resumed.table.equals(whole.table)
    files = [root / tables.EPISODES_FILE for root in (folder, tmp_path / "whole")]
    assert files[0].read_bytes() == files[1].read_bytes()
