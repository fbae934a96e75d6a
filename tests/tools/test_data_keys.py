"""Tables under docs/data have keys, and others in their place are noticed."""

import shutil
from pathlib import Path

import polars as pl
import pytest

from evaluation.record import tables
from tests.untrained import halved, published, teams_of
from tools.data_keys import DATA, FILE, check_keys, keys_of
from zoo.registry import load_registry

PLACE = "v0/crossplay/scratch"


def test_committed_tables_have_their_keys() -> None:
    assert check_keys(DATA, load_registry()) == []


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """One cross-play of a small zoo, with its key."""
    registry = load_registry(published(teams_of(1), tmp_path / "zoo"))
    folder = tmp_path / "data" / PLACE
    folder.mkdir(parents=True)
    rows = [{"ego": f"{team}/robot", "partner": f"{team}/human"} for team in registry.data.teams]
    tables.write_parquet(pl.DataFrame(rows), folder / tables.PAIRS_FILE)
    tables.write_json({"task": "scratch", "release": "v0"}, folder / tables.SUMMARY_FILE)
    data = tmp_path / "data"
    tables.write_json(keys_of(data, registry), data / FILE)
    return data


def test_changed_or_new_data_is_noticed(data: Path, tmp_path: Path) -> None:
    registry = load_registry(tmp_path / "zoo" / "registry.json")
    assert check_keys(data, registry) == []
    other = load_registry(published(halved(teams_of(1)), tmp_path / "other"))
    assert check_keys(data, other) == [f"docs/data/{PLACE}: another policies than its key"]
    path = data / PLACE / tables.SUMMARY_FILE
    path.write_text(path.read_text().replace("v0", "v1"))
    problem = f"docs/data/{PLACE}: another files, release than its key"
    assert check_keys(data, registry) == [problem]
    shutil.copytree(data / PLACE, data / "v9")
    assert any("docs/data/v9: another" in problem for problem in check_keys(data, registry))
