"""`assistax-zoo plot`: figures from saved folders, and one clear line where a folder is not one."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from assistax_zoo.commands.evaluation import plot
from assistax_zoo.shell.main import run
from evaluation.figures import saved_tables as derived
from evaluation.record import tables
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, clustered_matrix, episode_table, teams
from tests.zoo.conftest import put, trained_teams


@pytest.fixture
def crossplay_folder(tmp_path: Path) -> Path:
    population = teams(6, ("ippo",), ("d1", "d9"))
    table = episode_table(clustered_matrix(6, 2)[:, :, None], population, population)
    derived.save_crossplay(Record(table, tmp_path / "xp"), CONTEXT)
    return tmp_path / "xp"


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
    for path in crossplay_folder.iterdir():
        if path.name not in (tables.PAIRS_FILE, tables.SUMMARY_FILE):
            path.unlink()
    out = tmp_path / "figures" / f"matrix.{ending}"
    assert call("crossplay", crossplay_folder, "--out", out, *order) == 0
    assert out.stat().st_size > 10_000
    assert capfd.readouterr().out == f"{out}\n"


def test_a_bare_crossplay_has_no_legend_and_prints_its_words(
    crossplay_folder: Path, tmp_path: Path, capfd
):
    sizes = {}
    for legend in ((), ("--legend", "below"), ("--bare",), ("--bare", "--legend", "below")):
        out = tmp_path / "x.svg"
        words = ("crossplay", crossplay_folder, "--out", out, "--width", "3.3", *legend)
        assert call(*words) == 0
        printed = capfd.readouterr().out.splitlines()
        drawn = out.read_text(encoding="utf-8")
        assert 'width="237.6pt"' in drawn
        assert (">0.4 (d9)<" in drawn) == (legend != ("--bare",))
        sizes[legend] = len(printed)
        assert printed[0] == str(out)
        if "--bare" in legend:
            assert printed[1] == "Cross-play: scratch" and "n = 6 robots" in printed[3]
    assert list(sizes.values()) == [1, 1, 4, 4]


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


def failure(capfd, *words: object) -> str:
    """Return the one line of a figure that is not drawn."""
    assert call(*words) == 1
    captured = capfd.readouterr()
    assert captured.out == "" and "Traceback" not in captured.err
    assert captured.err.count("\n") == 1
    return captured.err


def test_wrong_folders_and_names_get_one_line(
    crossplay_folder: Path, evaluation_folder: Path, tmp_path: Path, capfd
):
    out, gone, summary = tmp_path / "x.png", tmp_path / "gone", crossplay_folder / "summary.json"
    ends = "ends in '.jpg'; figures are written as .png, .pdf, .svg"
    for figure, folder, place, message in (
        ("crossplay", gone, out, f"{gone} is not a folder; run `assistax-zoo crossplay` into it"),
        ("crossplay", evaluation_folder, out, "holds an evaluation; this figure is of a folder"),
        ("zsc", crossplay_folder, out, "xp holds a cross-play; this figure is of a folder that"),
        ("crossplay", crossplay_folder, tmp_path / "x.jpg", ends),
        ("crossplay", crossplay_folder, summary / "x.png", "summary.json"),
    ):
        assert message in failure(capfd, figure, folder, "--out", place)
    summary.write_text("{")
    message = failure(capfd, "crossplay", crossplay_folder, "--out", out)
    assert "summary.json is not readable JSON" in message
    assert not out.exists()
    assert call("crossplay", crossplay_folder, "--out", "x.png", "--order", "mixed") == 2


@pytest.mark.parametrize("draw", [plot.zsc, plot.disability, plot.profile])
def test_evaluations_are_drawn_by_method(draw, evaluation_folder: Path, tmp_path: Path):
    out = tmp_path / "figure.png"
    draw((evaluation_folder,), out=out)
    assert out.stat().st_size > 5_000
    with pytest.raises(ValueError, match="two folders are named ppo"):
        draw((evaluation_folder, evaluation_folder), out=out)
    with pytest.raises(ValueError, match="there is no folder to draw"):
        draw((), out=out)


def test_curves_of_a_run(tmp_path: Path):
    steps, seeds = np.repeat(100 * np.arange(1, 20), 3), np.tile(np.arange(3), 19)
    rows = {"steps": steps, "seed": seeds, "return": steps / 100.0 + seeds}
    table = pl.DataFrame({**rows, "disability": ["d1"] * len(steps)})
    table.write_parquet(tmp_path / "metrics.parquet")
    tables.write_json({"config": {"task": "scratch"}}, tmp_path / "config.json")
    plot.curves(tmp_path, out=tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 5_000


def test_population_of_a_registry(tmp_path: Path, capfd):
    registry, out = tmp_path / "registry.json", tmp_path / "population.png"
    put(trained_teams(), registry)
    plot.population(out=out, registry=registry)
    assert out.stat().st_size > 5_000
    assert capfd.readouterr().out == f"{out}\n"


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
    assert "preset.json" in failure(capfd, "sweep", tmp_path, "--out", tmp_path / "sweep.png")
    (tmp_path / "preset.json").write_text('{"algorithm": "ippo", "hyperparameters": {}}')
    assert call("sweep", tmp_path, "--out", tmp_path / "sweep.png") == 0
    assert (tmp_path / "sweep.png").stat().st_size > 5000
