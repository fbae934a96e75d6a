"""Tables under docs/data have keys, and others in their place are noticed."""

import shutil
from pathlib import Path

import polars as pl
import pytest

from evaluation.record import tables
from tests.untrained import halved, published, teams_of
from tools.data_keys import DATA, FILE, check_keys, keys_of
from zoo.registry import Registry, load_registry

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


def registry_of(data: Path) -> Registry:
    return load_registry(data.parent / "zoo" / "registry.json")


def test_a_changed_table_is_noticed(data: Path) -> None:
    assert check_keys(data, registry_of(data)) == []
    path = data / PLACE / tables.SUMMARY_FILE
    path.write_text(path.read_text().replace("v0", "v1"))
    assert check_keys(data, registry_of(data)) == [
        f"docs/data/{PLACE}: another files, release than its key"
    ]


def test_partners_of_another_registry_are_noticed(data: Path, tmp_path: Path) -> None:
    other = load_registry(published(halved(teams_of(1)), tmp_path / "other"))
    assert check_keys(data, other) == [f"docs/data/{PLACE}: another policies than its key"]


def test_a_new_folder_without_key_is_noticed(data: Path) -> None:
    shutil.copytree(data / PLACE, data / "v9")
    assert "docs/data/v9: another" in check_keys(data, registry_of(data))[0]
