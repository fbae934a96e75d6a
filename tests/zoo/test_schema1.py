"""What was written at schema version 1 reads as before: a registry, its lock, and one of the v1."""

import json
import shutil
from pathlib import Path

import pytest

from assistax_base.errors import LockError
from zoo.lock import apply_lock, locked_entries, read_lock
from zoo.parameters.storage import load_stacks
from zoo.registry import load_registry
from zoo.saving import save_registry
from zoo.verify import verify

OLD = Path(__file__).parent / "schema1"
ROOT = Path(__file__).parents[2]


def test_a_registry_of_the_first_schema_reads_as_before() -> None:
    data, registry = (
        json.loads((OLD / "registry.json").read_text()),
        load_registry(OLD / "registry.json"),
    )
    assert data["schema_version"] == 1 and len(registry.policies) == 16
    for team, entry in data["teams"].items():
        self_play = registry.team(team).self_play
        assert self_play is not None and list(self_play.mean_ci) == entry["self_play"]["ci"]
    assert registry.split("scratch").sha256 == data["splits"][0]["sha256"]
    assert verify(registry).ok and load_stacks(registry, registry.policies)


def test_migration_changes_no_figure_and_no_root(tmp_path: Path) -> None:
    shutil.copytree(OLD, tmp_path, dirs_exist_ok=True)
    old = load_registry(tmp_path / "registry.json")
    new = save_registry(old.data, old.path)
    assert new.root("v0") == old.root("v0") == new.data.releases["v0"].root
    assert new.policies == old.policies and verify(new).ok
    text = json.loads(new.path.read_text())
    assert text["schema_version"] == 2
    text["releases"]["v0"].pop("root")
    for team in text["teams"].values():
        team["self_play"]["ci"] = team["self_play"].pop("mean_ci")
    assert {**text, "schema_version": 1} == json.loads((OLD / "registry.json").read_text())


def test_a_lock_of_the_first_version_pins_as_before() -> None:
    registry, lock = load_registry(OLD / "registry.json"), read_lock(OLD / "assistax-zoo.lock")
    assert lock.lock_version == 1 and lock.root is None
    assert len(apply_lock(registry, lock, task="scratch").policies) == 16
    text = (OLD / "assistax-zoo.lock").read_text()
    assert '"leaves"' not in text


def test_a_lock_of_release_v1_still_finds_its_policies(tmp_path: Path) -> None:
    lock = read_lock(OLD / "installed.lock")
    registry = load_registry(ROOT / "registry.json")
    assert {entry.id: entry.sha256 for entry in locked_entries(registry, lock)} == lock.policies
    path = tmp_path / "edited.lock"
    path.write_text((OLD / "installed.lock").read_text().replace('"v1"', '"v0"', 1))
    with pytest.raises(LockError, match="it was edited"):
        read_lock(path)
