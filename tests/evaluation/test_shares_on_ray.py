"""Cross-play on a real Ray of two CPUs on this machine, through the command."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from assistax_base.cluster import RayCluster
from assistax_zoo.shell.main import run
from evaluation.cast.roster import joined
from evaluation.play import shares as blocks
from evaluation.play import tiles
from evaluation.play.jobs import Job
from evaluation.play.shares import run_blocks_on_ray
from tests import untrained
from tests.evaluation.matrix_game import GRU, MatrixGame, humans, random_roster, robots
from tests.untrained import ROBOT

SMALL = dataclasses.replace(ROBOT, hidden=(4,))


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A registry of teams whose robots are of two specs, which cannot share a chunk."""
    teams = [untrained.teams_of(2, robot)[seed] for seed, robot in enumerate((ROBOT, SMALL))]
    return untrained.published(teams, tmp_path_factory.mktemp("zoo"))


@pytest.mark.slow
def test_crossplay_on_ray_equals_single_run(published: Path, tmp_path: Path, capfd: Any):
    words = ["crossplay", "--task", "scratch", "--registry", str(published), "--episodes", "1"]
    words += ["--backend", "native", "--max-envs", "2"]
    assert run([*words, "--out", str(tmp_path / "local")]) == 0
    assert run([*words, "--out", str(tmp_path / "ray"), "--engine", "ray", "--ray-cpus", "1"]) == 0
    printed = capfd.readouterr()
    assert "found finished" in printed.out  # the parts came from the workers
    for name in ("episodes.parquet", "pairs.parquet"):
        assert (tmp_path / "ray" / name).read_bytes() == (tmp_path / "local" / name).read_bytes()
    # Finished: no cluster is started.
    assert run([*words, "--out", str(tmp_path / "ray"), "--engine", "ray"]) == 0


def test_parts_that_are_not_here_are_missed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(tiles, "SMALL_JOB", 0)  # a part for each network
    egos = joined(robots(1.0), random_roster(GRU, 1, 3))
    job = Job("matrix", 1, "native", egos, humans(1.0, -1.0), episodes=2)
    for here, played in (  # no worker, and one worker of two, wrote to this disk
        (0, lambda *_: None),
        (1, lambda *args: blocks._run_remotely(0, 2, *args[3])),
    ):
        monkeypatch.setattr(blocks, "run_blocks", played)
        with pytest.raises(ValueError, match=rf"has {here} of 2 parts here; write to a folder"):
            run_blocks_on_ray(MatrixGame, job, tmp_path, RayCluster(), max_envs=1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--share", "1/2", "--engine", "ray"], "--share is one share of a run by hand"),
        (["--ray-cpus", "2"], "--ray-cpus needs --engine ray"),
        (["--engine", "ray", "--ray-cpus", "-1"], "a block takes -1.0 CPUs"),
    ],
)
def test_options_that_do_not_fit_get_one_line(
    words: list[str], message: str, tmp_path: Path, capsys: Any
):
    assert run(["crossplay", "--task", "scratch", "--out", str(tmp_path / "xp"), *words]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "xp").exists()
