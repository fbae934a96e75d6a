"""`assistax-zoo plot`: figures from saved folders, and one clear line where a folder is not one."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from assistax_workshop.press.publish import publish
from assistax_zoo.commands.evaluation import plot
from assistax_zoo.shell.main import run
from evaluation.figures import saved_tables as derived
from evaluation.record import tables
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, clustered_matrix, episode_table, teams
from tests.zoo.conftest import trained_team


@pytest.fixture
def crossplay_folder(tmp_path: Path) -> Path:
    population = teams(6, ("ippo",), ("d1", "d9"))
    folder = tmp_path / "xp"
    derived.save_crossplay(
        Record(episode_table(clustered_matrix(6, 2)[:, :, None], population, population), folder),
        CONTEXT,
    )
    return folder


@pytest.fixture
def evaluation_folder(tmp_path: Path) -> Path:
    returns = np.random.default_rng(0).normal(500, 50, (2, 4, 2))
    table = episode_table(returns, ["a", "b"], teams(4), ["test", "train"] * 2)
    derived.save_evaluation(Record(table, tmp_path / "ppo"), CONTEXT)
    return tmp_path / "ppo"


def call(*words: object) -> int:
    return run(["plot", *map(str, words)])


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
@pytest.mark.parametrize("order", [(), ("--order", "separate")])
def test_crossplay_draws_the_saved_matrix_and_says_where(
    crossplay_folder: Path, tmp_path: Path, capfd, ending: str, order: tuple[str, ...]
):
    out = tmp_path / "figures" / f"matrix.{ending}"
    assert call("crossplay", crossplay_folder, "--out", out, *order) == 0
    assert out.stat().st_size > 10_000
    assert capfd.readouterr().out == f"{out}\n"


def test_crossplay_reads_only_the_saved_matrix_and_summary(crossplay_folder: Path, tmp_path: Path):
    for path in crossplay_folder.iterdir():
        if path.name not in (tables.PAIRS_FILE, tables.SUMMARY_FILE):
            path.unlink()
    assert call("crossplay", crossplay_folder, "--out", tmp_path / "matrix.png") == 0


def test_a_forged_order_is_not_drawn(crossplay_folder: Path, tmp_path: Path):
    path, drawn = crossplay_folder / tables.ORDER_FILE, []
    forged = tables.read_json(path)
    for axis in ("rows", "columns", "teams"):
        forged[axis]["order"].reverse()
        forged[axis]["silhouette"] = 1.0
    for content in (path.read_text(), json.dumps(forged), "{"):
        path.write_text(content)
        out = tmp_path / f"{len(drawn)}.png"
        assert call("crossplay", crossplay_folder, "--out", out) == 0
        drawn.append(out.read_bytes())
    assert drawn[0] == drawn[1] == drawn[2]


def failure(capfd, code: int) -> str:
    captured = capfd.readouterr()
    assert code == 1
    assert captured.out == ""
    assert "Traceback" not in captured.err
    assert captured.err.count("\n") == 1
    return captured.err


def test_wrong_folders_and_names_get_one_line(
    crossplay_folder: Path, evaluation_folder: Path, tmp_path: Path, capfd
):
    out = tmp_path / "x.png"
    gone = tmp_path / "gone"
    assert f"{gone} is not a folder; run `assistax-zoo crossplay` into it" in failure(
        capfd, call("crossplay", gone, "--out", out)
    )
    assert (
        "holds an evaluation; this figure is of a folder that `assistax-zoo crossplay"
        in failure(capfd, call("crossplay", evaluation_folder, "--out", out))
    )
    assert "ends in '.jpg'; figures are written as .png, .pdf, .svg" in failure(
        capfd, call("crossplay", crossplay_folder, "--out", tmp_path / "x.jpg")
    )
    (crossplay_folder / tables.SUMMARY_FILE).write_text("{")
    assert "summary.json is not readable JSON" in failure(
        capfd, call("crossplay", crossplay_folder, "--out", out)
    )
    assert not out.exists()


def test_a_place_that_cannot_be_written_gets_one_line(crossplay_folder: Path, capfd):
    out = crossplay_folder / tables.SUMMARY_FILE / "x.png"
    assert "summary.json" in failure(capfd, call("crossplay", crossplay_folder, "--out", out))


def test_wrong_usage_has_code_2(crossplay_folder: Path, capfd):
    assert call("crossplay", crossplay_folder) == 2
    assert call("crossplay", crossplay_folder, "--out", "x.png", "--order", "mixed") == 2
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("draw", [plot.zsc, plot.disability, plot.profile])
def test_evaluations_are_drawn_by_method(draw, evaluation_folder: Path, tmp_path: Path):
    out = tmp_path / "figure.png"
    draw((evaluation_folder,), out=out)
    assert out.stat().st_size > 5_000
    with pytest.raises(ValueError, match="two folders are named ppo"):
        draw((evaluation_folder, evaluation_folder), out=out)
    with pytest.raises(ValueError, match="there is no folder to draw"):
        draw((), out=out)


def test_a_crossplay_is_not_an_evaluation(crossplay_folder: Path, tmp_path: Path):
    with pytest.raises(
        ValueError,
        match="xp holds a cross-play; this figure is of a folder that `assistax-zoo evaluate",
    ):
        plot.zsc((crossplay_folder,), out=tmp_path / "x.png")


def test_curves_of_a_run(tmp_path: Path):
    rows = [
        {"steps": 100 * u, "disability": "d1", "seed": s, "return": float(u + s)}
        for u in range(1, 20)
        for s in range(3)
    ]
    pl.DataFrame(rows).write_parquet(tmp_path / "metrics.parquet")
    tables.write_json({"config": {"task": "scratch"}}, tmp_path / "config.json")
    plot.curves(tmp_path, out=tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 5_000


def test_population_of_a_registry(tmp_path: Path, capfd):
    registry = tmp_path / "registry.json"
    population = [
        trained_team(disability=disability, seed=seed)
        for disability in ("d1", "d9")
        for seed in range(2)
    ]
    publish(population, registry, "v0", date="2026-01-01")
    plot.population(out=tmp_path / "population.png", registry=registry)
    assert (tmp_path / "population.png").stat().st_size > 5_000
    assert capfd.readouterr().out == f"{tmp_path / 'population.png'}\n"


def test_a_sweep_is_drawn_with_ranges_and_values(tmp_path: Path, capfd):
    rng = np.random.default_rng(0)
    table = pl.DataFrame(
        {
            "configuration": np.repeat(np.arange(6), 2),
            "seed": [0, 1] * 6,
            "learning_rate": np.repeat(10.0 ** rng.uniform(-4, -2, 6), 2),
            "rollout_steps": np.repeat([64, 128] * 3, 2),
            "final_return": [None, *rng.uniform(0, 900, 11)],
            "auc": rng.uniform(0, 900, 12),
            "diverged": [True, *[False] * 11],
        }
    )
    table.write_parquet(tmp_path / "sweep.parquet")
    assert "preset.json" in failure(capfd, call("sweep", tmp_path, "--out", tmp_path / "sweep.png"))
    (tmp_path / "preset.json").write_text('{"algorithm": "ippo", "hyperparameters": {}}')
    assert call("sweep", tmp_path, "--out", tmp_path / "sweep.png") == 0
    assert (tmp_path / "sweep.png").stat().st_size > 5000
