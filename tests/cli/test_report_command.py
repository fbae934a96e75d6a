import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from assistax_base.errors import FormatError
from assistax_zoo.comparing import compare
from assistax_zoo.shell.main import run
from evaluation.figures.saved_tables import save_crossplay, save_evaluation
from evaluation.record import manifest as provenance
from evaluation.record import tables
from evaluation.record.record import Record
from tests.evaluation.episode_tables import CONTEXT, clustered_matrix, episode_table, teams

HOSTILE = "\x1b]0;owned\x07\x9b31m[red]\nverified 9 files\u202e"


def call(*words: Any) -> int:
    return run([str(word) for word in words])


def evaluated(folder: Path, shift: float = 0.0, ego: str = "mine", **changes: Any) -> Path:
    """An evaluation of one robot with 8 partners, `shift` above that of shift 0."""
    returns = np.random.default_rng(0).normal(500, 50, (1, 8, 2)) + shift
    table = episode_table(returns, [ego], teams(8), ["test", "train"] * 4)
    context = dataclasses.replace(CONTEXT, **changes)
    tables.write_episodes(table, folder / tables.EPISODES_FILE)
    save_evaluation(Record(table, folder), context)
    return folder


@pytest.fixture
def crossplay(tmp_path: Path) -> Path:
    table = episode_table(clustered_matrix(6, 2)[:, :, None], teams(6), teams(6))
    table = table.with_columns((10.0 * (pl.col("partner_seed") % 2)).alias("force_mean"))
    save_crossplay(Record(table, tmp_path / "xp"), CONTEXT)
    return tmp_path / "xp"


def test_compare_prints_the_paired_difference(tmp_path: Path, capfd):
    a, b = evaluated(tmp_path / "a", 10.0), evaluated(tmp_path / "b")
    assert call("compare", a, b, "--json") == 0
    figures = json.loads(capfd.readouterr().out)
    assert (figures["a"], figures["b"], figures["task"]) == (str(a), str(b), "scratch")
    for side in ("test", "train"):
        assert figures[side]["mean"] == pytest.approx(10.0, abs=1e-3)
        assert (figures[side]["p_positive"], figures[side]["partners_better"]) == (1.0, 1.0)
        assert (figures[side]["seeds"], figures[side]["partners"]) == ([1, 1], 4)
        first, second = figures[side]["means"]
        assert first - second == pytest.approx(10.0, abs=1e-3)
    assert call("compare", b, a) == 0
    printed = capfd.readouterr().out
    assert "test  partners: mean -10.0" in printed
    assert f"means {second:.1f} and {first:.1f}, 1 and 1 seeds, 4 partners" in printed


def test_what_nobody_checked_is_said(tmp_path: Path, capfd):
    a, b = evaluated(tmp_path / "a", 10.0), evaluated(tmp_path / "b")
    assert call("compare", a, b) == 0
    printed = capfd.readouterr().out
    for folder in (a, b):
        assert f"note: {folder} has no manifest.json: nothing of it" in printed
    provenance.seal(a)
    assert call("compare", a, b) == 0
    printed = capfd.readouterr().out
    assert f"{b} has no manifest.json" in printed and f"{a} has no" not in printed
    manifest = provenance.read_manifest(b := a) or {}
    files = {name: manifest["files"][name] for name in manifest["files"] if "episodes" not in name}
    provenance.write_manifest(b, {"files": files})
    assert call("compare", a, b) == 0
    assert "hence not checked: episodes.parquet\n" in capfd.readouterr().out


@pytest.mark.parametrize("column", ["key", "steps", "episode"])
def test_numbers_that_numpy_lacks_get_one_line(tmp_path: Path, column: str, capfd):
    a = evaluated(tmp_path / "a")
    table = pl.read_parquet(a / tables.EPISODES_FILE).with_columns(pl.col(column).cast(pl.Int128))
    tables.write_parquet(table, a / tables.EPISODES_FILE)
    for words in (("compare", a, a), ("strategies", a)):
        (a / tables.PAIRS_FILE).write_bytes((a / tables.EPISODES_FILE).read_bytes())
        assert call(*words) == 1
        error = capfd.readouterr().err
        assert f"column '{column}' is Int128; integers of at most 64 bits" in error
        assert error.count("\n") == 1


def test_names_of_a_received_folder_command_no_terminal(tmp_path: Path, crossplay: Path, capfd):
    table = episode_table(clustered_matrix(6, 2)[:, :, None], teams(6), teams(6))
    evil = pl.col("partner") + HOSTILE
    table = table.with_columns(partner=evil, partner_team=evil)
    save_crossplay(Record(table, tmp_path / "evil"), CONTEXT)
    assert call("strategies", tmp_path / "evil") == 0
    printed = capfd.readouterr().out
    assert "[red]" in printed and not set(HOSTILE) & set("\x1b\x9b\x07") & set(printed)
    assert "\nverified" not in printed


def test_methods_evaluated_unlike_are_not_compared(tmp_path: Path, crossplay: Path, capfd):
    a, b = evaluated(tmp_path / "a"), evaluated(tmp_path / "b", backend="mjx")
    engine = {"name": "native", "version": "another"}
    for other, message in (
        (b, "backend is native in"),
        (evaluated(tmp_path / "d", engine=engine), "engine is {} in"),
        (crossplay, "holds a cross-play; compare takes evaluations"),
        (tmp_path / "c", "not exist"),
    ):
        assert call("compare", a, other) == 1
        error = capfd.readouterr().err
        assert message in error
        assert error.count("\n") == 1


@pytest.mark.parametrize(
    "robot", ["scratch/ppo-ego-s0", "zoo:scratch/ppo-ego-s0-v1/robot", "mine.py", "robots/a.onnx"]
)
def test_compare_says_to_evaluate_a_robot_first(tmp_path: Path, robot: str, capfd):
    a = evaluated(tmp_path / "a")
    for folders in ((a, robot), (robot, a)):
        assert call("compare", *folders) == 1
        error = capfd.readouterr().err
        assert f"{robot!r}: expected a folder of results, found the name of a robot" in error
        assert "`assistax-zoo evaluate NAME --out FOLDER` does so" in error
        assert error.count("\n") == 1
    with pytest.raises(FormatError, match="evaluate the robot into a folder first") as caught:
        compare(a, robot)
    assert "--" not in str(caught.value)


def test_folder_named_as_a_robot_is_a_folder(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    evaluated(tmp_path / "zero")
    assert call("compare", "zero", "zero") == 0


def test_strategies_of_a_crossplay(crossplay: Path, capfd):
    assert call("strategies", crossplay, "--json") == 0
    printed = json.loads(capfd.readouterr().out)
    assert printed == tables.read_json(crossplay / tables.STRATEGIES_FILE)
    assert len(printed["clusters"]) == 2
    assert call("strategies", crossplay) == 0
    strategies = capfd.readouterr().out
    words = ("BR-Div: rank 1 of 6", "most incompatible", "medoid")
    assert all(word in strategies for word in words)
    table = strategies.partition("BR-Div")[0]
    assert "…" not in table and max(map(len, strategies.splitlines())) <= 80
    assert " ippo-d1-s" in table and "scratch/" not in table
    assert call("strategies", crossplay / "none") == 1
    assert "does not exist" in capfd.readouterr().err


def test_report_writes_a_page_and_says_where(crossplay: Path, tmp_path: Path, capfd):
    assert call("report", crossplay, "--out", tmp_path / "r.html") == 0
    assert capfd.readouterr().out == f"{tmp_path / 'r.html'}\n"
    assert (tmp_path / "r.html").read_text().startswith("<!doctype html>")
    assert call("report", crossplay, "--out", tmp_path / "r.pdf") == 1
    assert "a report is written as .html" in capfd.readouterr().err
    assert call("report", crossplay) == 2
