"""A replay says how much of the headline figure it confirms, and how much could be hidden."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import assistax_zoo as az
from assistax_zoo.shell.main import run
from evaluation.play.evaluator import MAX_ENVS
from evaluation.play.tiles import GPU_TILE_ENVS, TILE_ENVS
from evaluation.record.manifest import file_sha256
from evaluation.replay.headline import Headline, Reach, hidden_share, verdict_of
from evaluation.replay.job import tile_envs_of
from evaluation.replay.noise import differing_rows
from evaluation.replay.received import received_robots
from evaluation.replay.replay import ReplayReport
from zoo.registry import load_registry

FIGURE = Headline("M_test", -200.0, pl.lit(value=True))


@pytest.mark.parametrize(
    ("hidden", "unplayed", "same_bits", "verdict"),
    [
        (0.0, 0, True, "same"),
        (0.0, 3, True, "sampled"),
        (None, 9, True, "sampled"),
        (10.0, 0, False, "within noise"),
        (10.1, 0, False, "cannot be told"),
        (10.0, 3, False, "within noise"),
        (None, 9, False, "cannot be told"),
    ],
)
def test_verdict_follows_hidden_share(
    hidden: float | None, unplayed: int, same_bits: bool, verdict: str
) -> None:
    assert verdict_of(FIGURE, Reach(1, 9, unplayed, hidden), same_bits=same_bits) == verdict


def test_raised_figure_makes_no_smaller_share() -> None:
    """Otherwise a raised figure would make the hidden share look small."""
    raised = dataclasses.replace(FIGURE, value=250.0)
    reach = Reach(1, 1, 0, 12.0, difference=-50.0)
    assert hidden_share(raised, reach) == pytest.approx(0.06)
    assert verdict_of(raised, reach, same_bits=False) == "cannot be told"
    zero = dataclasses.replace(FIGURE, value=0.0)
    assert verdict_of(zero, Reach(1, 1, 0, 0.1), same_bits=False) == "cannot be told"


@pytest.mark.parametrize("cut", [1, 7, 512, 32768, 98304])
def test_folder_chooses_no_tiles_on_mjx(cut: int) -> None:
    manifest = {"tile_envs": cut, "max_envs": cut}
    for backend in ("mjx", "mjx-warp"):
        assert tile_envs_of(backend, manifest) == MAX_ENVS[backend]
    ours = {"native": {TILE_ENVS["native"]}, "fused": {TILE_ENVS["fused"], GPU_TILE_ENVS}}
    for backend, allowed in ours.items():
        if cut in allowed:
            assert tile_envs_of(backend, manifest) == cut
        else:
            with pytest.raises(ValueError, match=f"tile_envs is {cut}; on {backend} it is"):
                tile_envs_of(backend, manifest)


def test_each_column_of_an_episode_is_compared() -> None:
    columns = {"ego": list("abc"), "return": [1.0, 2.0, 3.0], "success": [True, False, True]}
    table = pl.DataFrame({**columns, "clipped": [None, 0.1, None]})
    assert not differing_rows(table, table).any()
    changes = {"ego": "d", "return": 2.5, "success": True, "clipped": None}
    for name, value in changes.items():
        values = table[name].to_list()
        values[1] = value
        other = table.with_columns(pl.Series(name, values, table.schema[name]))
        assert differing_rows(table, other).tolist() == [False, True, False], name


def test_received_robots_are_neither_run_nor_read(tmp_path: Path) -> None:
    """A file of the name may lie in the folder itself; a reader may trust the folder."""
    zoo, folder, other = load_registry(), tmp_path / "received", tmp_path / "other"
    for place in (folder, other):
        place.mkdir()
    az.open_zoo().export("scratch/ippo-d1-s0-v1/robot", other / "mine.safetensors")
    digest = file_sha256(other / "mine.safetensors")
    (folder / "link").symlink_to(other)
    marker = tmp_path / "marker"
    outside = [f"{at}/mine.safetensors" for at in (other, f"{folder}/../other", f"{folder}/link")]
    for name in outside:
        with pytest.raises(ValueError, match="outside the folder, and the folder names it"):
            received_robots(folder, [[name, digest]], zoo, "scratch")
        trusted = received_robots(folder, [[name, digest]], zoo, "scratch", run_code=True)
        assert trusted.ids == (name,)
    code = f"python:subprocess:getoutput?cmd=touch {marker}"
    with pytest.raises(ValueError, match="is code, and the folder names it"):
        received_robots(folder, [[code, digest]], zoo, "scratch")
    shutil.copy(other / "mine.safetensors", folder)
    assert received_robots(folder, [[outside[0], digest]], zoo, "scratch").ids == (outside[0],)
    with pytest.raises(ValueError, match="is not the one that played"):
        received_robots(folder, [[outside[0], "0" * 64]], zoo, "scratch")
    assert not marker.exists()


REPORT = ReplayReport(
    *("out", 40, False, "other processor", 40, True),
    verdict="cannot be told",
    figure="M_test",
    value=985.8,
    difference=-180.2,
    hidden=240.0,
    hidden_share=0.243,
    hidden_flags={"success": 0.071},
    tiles=4,
    of_tiles=9,
    found=4 / 9,
    of_episodes=720,
)


@pytest.mark.parametrize(
    ("changes", "code", "said", "unsaid"),
    [
        ({}, 3, "cannot be told from another processor: up to 240.0 of it, 24.3%,", "the same"),
        ({}, 3, "could be hidden, success of 7.1% of episodes", "violated"),
        ({"verdict": "within noise", "hidden": 9.9, "hidden_share": 0.01}, 0, "up to 9.9", "same"),
        ({"difference": None, "hidden": None}, 3, "no episode of M_test was played", "same"),
        ({"verdict": "sampled", "exact": True}, 0, "a chance of 44%", "hidden"),
        ({"verdict": "same", "exact": True, "tiles": 9}, 0, "the same to the last bit", "chance"),
        ({"verdict": "differs", "ok": False, "problems": ("x",)}, 1, "not all within", "the same"),
    ],
)
def test_replay_command_prints_verdict(
    changes: dict[str, Any],
    code: int,
    said: str,
    unsaid: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    report = dataclasses.replace(REPORT, **changes)
    monkeypatch.setattr("evaluation.replay.replay.replay_folder", lambda *_, **__: report)
    if code:
        with pytest.raises(SystemExit, match=str(code)):
            run(["replay", "out"])
    else:
        assert run(["replay", "out"]) == 0
    printed = capfd.readouterr().out
    assert said in printed and unsaid not in printed


def test_the_bias_of_groups_is_the_mean_of_theirs() -> None:
    """So a group of few partners hides as much of M_test as one of many."""
    test = pl.col("partner_algorithm") == "stepper", pl.col("partner_algorithm") != "stepper"
    figure = Headline("M_test", 100.0, pl.lit(value=True), test)
    biases: dict[int, float | None] = {id(test[0]): 4.0, id(test[1]): 1.0}
    assert figure.mean_bias(lambda rows: biases[id(rows)]) == 2.5
    biases[id(test[1])] = None
    assert figure.mean_bias(lambda rows: biases[id(rows)]) is None
    assert FIGURE.mean_bias(lambda rows: 3.0) == 3.0
