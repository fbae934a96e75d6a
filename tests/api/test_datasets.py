"""Recordings in other libraries' formats hold what the recording holds, read by those libraries."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import assistax_zoo as az
from assistax_zoo.datasets import check_place, write_dataset

STEPS = 5
ABOUT = {"task": "gentle_scratch", "seed": 3, "robot": {"policy": "zero"}}
ABOUT["human"] = {"policy": "random"}


@pytest.fixture(scope="module")
def table() -> pl.DataFrame:
    """Return two short episodes of a gentle task."""
    return az.trajectories(
        "zero", "random", task="gentle_scratch", episodes=2, steps=STEPS, seed=3, backend="native"
    )


def test_minari_reads_the_recording(
    table: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.chdir(tmp_path)
    write_dataset(table, Path("zero-v0"), ABOUT, "minari")
    assert [path.name for path in tmp_path.iterdir()] == ["zero-v0"]  # nothing half written
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = minari.load_dataset("zero-v0")
    assert (dataset.total_episodes, dataset.total_steps) == (2, 2 * STEPS)
    for number, episode in enumerate(dataset):
        rows = table.filter(episode=number)
        steps = rows.drop_nulls("reward")
        for role in ("robot", "human"):
            seen, did = rows[f"{role}_observation"], steps[f"{role}_action"]
            np.testing.assert_array_equal(episode.observations[role], seen.to_numpy())
            np.testing.assert_array_equal(episode.actions[role], did.to_numpy())
        np.testing.assert_array_equal(episode.rewards, steps["reward"].to_numpy())
        assert episode.truncations.tolist() == steps["truncated"].to_list()
        force = episode.infos["force"]
        assert np.isnan(force[0]) and force[1:].tolist() == steps["force"].to_list()
        np.testing.assert_array_equal(episode.infos["pose"], rows["pose"].to_numpy())
        assert dataset.observation_space["robot"].contains(episode.observations["robot"][0])
    assert json.loads(dataset.storage.metadata["assistax"]) == ABOUT


def test_lerobot_files_hold_the_recording(table: pl.DataFrame, tmp_path: Path) -> None:
    """Its own library reads them in tests/frameworks, where it is installed."""
    pytest.importorskip("pyarrow")
    write_dataset(table, tmp_path / "pair", ABOUT, "lerobot")
    frames = pl.read_parquet(tmp_path / "pair/data/chunk-000/file-000.parquet")
    steps = table.drop_nulls("reward")
    for name, column in {
        "observation.state": "robot_observation",
        "observation.human_state": "human_observation",
        "action": "robot_action",
        "human_action": "human_action",
        "next.reward": "reward",
        "next.force": "force",
        "observation.pose": "pose",
    }.items():
        np.testing.assert_array_equal(frames[name].to_numpy(), steps[column].to_numpy())
    assert frames["index"].to_list() == list(range(2 * STEPS))
    np.testing.assert_allclose(frames["timestamp"][STEPS - 1], (STEPS - 1) / 50)
    stats = json.loads((tmp_path / "pair/meta/stats.json").read_text())
    np.testing.assert_allclose(stats["next.reward"]["mean"], [steps["reward"].mean()])


@pytest.mark.parametrize(
    ("name", "format", "words"),
    [
        ("new", "csv", "allowed are parquet, minari, lerobot"),
        ("taken-v0", "minari", "taken-v0 exists"),
        ("taken-v0", "lerobot", "taken-v0 exists"),
        ("new", "minari", "such as scratch-v0"),
    ],
)
def test_wrong_place_is_refused_before_play(
    tmp_path: Path, name: str, format: str, words: str
) -> None:
    (tmp_path / "taken-v0").mkdir()
    with pytest.raises(ValueError, match=re.escape(words)):
        check_place(tmp_path / name, format)


def test_missing_package_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "minari", None)
    words = "the format minari needs the package minari; install it with: pip install"
    with pytest.raises(ValueError, match=re.escape(f"{words} 'assistax-zoo[minari]'")):
        check_place(tmp_path / "new-v0", "minari")
