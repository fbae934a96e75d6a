import json
from pathlib import Path
from typing import Any

import pytest

from assistax_base.errors import LockError, SplitError, UnknownIdError
from assistax_zoo.shell.main import run
from tests.zoo.conftest import edited
from zoo.history.merkle import check_roots, leaves, with_roots
from zoo.lock import Lock, apply_lock, locked_entries, read_lock
from zoo.locking import make_lock, write_lock
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, build_registry, load_registry
from zoo.saving import dump_registry
from zoo.splitting.create import create_split
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import remote_registry


@pytest.fixture
def lock(registry: Registry, tmp_path: Path) -> Lock:
    path = tmp_path / "assistax-zoo.lock"
    write_lock(make_lock(registry, registry.policies), path)
    return read_lock(path)


def test_a_lock_pins_bytes_and_split(registry: Registry, lock: Lock) -> None:
    assert lock.release == "v0" and lock.environments == {"scratch": 1}
    assert lock.policies == {entry.id: entry.sha256 for entry in registry.policies}
    assert lock.splits["scratch"].sha256 == registry.split("scratch").sha256
    narrowed = apply_lock(registry, lock, task="scratch")
    assert narrowed.lock == lock.sha256
    assert narrowed.policies == registry.policies
    assert narrowed.split("scratch") == registry.split("scratch")
    assert [group.ids for group in load_stacks(narrowed, narrowed.policies)]


def test_a_registry_that_grew_is_as_good(registry: Registry, lock: Lock, teams, publish_to) -> None:
    split = registry.split("scratch")
    publish_to(teams(("ippo", "mappo"), seeds=range(6)), registry.path)
    publish_to(teams(("isac",)), registry.path, "v1")
    grown = load_registry(registry.path)
    assert grown.release == "v1" and grown.split("scratch", release="v0") != split
    narrowed = apply_lock(grown, lock, task="scratch")
    assert narrowed.release == "v0" and narrowed.policies == registry.policies
    assert narrowed.split("scratch") == split
    with pytest.raises(UnknownIdError):
        narrowed.select("scratch/mappo-*")


def test_a_setting_that_nobody_uses_changes_no_lock(registry: Registry, lock: Lock) -> None:
    def unused_setting(data: dict[str, Any]) -> None:
        data["disability_settings"]["d42"] = {**data["disability_settings"]["d1"], "tremor": 0.5}

    grown = edited(registry, unused_setting)
    check_roots(grown.data, "grown")
    assert apply_lock(grown, lock, task="scratch").policies == registry.policies


def test_lock_loads_the_same_bytes_elsewhere(registry: Registry, lock: Lock, cache: Path) -> None:
    remote = remote_registry(open_remote(registry.path.parent))
    assert locked_entries(remote, lock) == locked_entries(registry, lock)


def test_anything_else_is_refused(registry: Registry, lock: Lock) -> None:
    other = create_split(registry.path, task="scratch", seed=1)
    registry = load_registry(registry.path)
    with pytest.raises(LockError, match="expected a task of the lock"):
        apply_lock(registry, lock, task="bed_bath")
    with pytest.raises(LockError, match="expected the locked one"):
        apply_lock(registry, lock, task="scratch", split=other.id)
    with pytest.raises(LockError, match="expected the locked one"):
        apply_lock(registry, lock, task="scratch", split="half-s1:both")
    for side in (None, "test", "both", lock.splits["scratch"].id, "half-s0:train"):
        apply_lock(registry, lock, task="scratch", split=side)
    with pytest.raises(SplitError):
        apply_lock(registry, lock, task="scratch").split("scratch", other.id)


def test_a_registry_that_differs_is_refused(
    registry: Registry, lock: Lock, teams, publish_to, tmp_path
) -> None:
    team = next(iter(registry.data.teams))
    original = registry.path.read_text()

    human = registry.data.teams[team].policies["human"]
    other = {"sha256": "0" * 64}
    for change, message in (
        (lambda d: d["teams"][team]["policies"]["human"].update(other), f"policy {team}/human"),
        (lambda d: d["shards"][human.shard].update(other), "entry shard zoo/shards/paper/"),
        (lambda d: d["disability_settings"]["d9"].update(tremor=0.1), "entry setting d9"),
        (
            lambda d: d["releases"]["v0"]["environments"].update(scratch=2),
            "environment version of scratch 1",
        ),
    ):
        registry.path.write_text(original)
        words = f"expected {message}.*as locked, found .*; nothing was done; next: fetch"
        with pytest.raises(LockError, match=words):
            apply_lock(edited(registry, change), lock, task="scratch")
    smaller = publish_to(teams(seeds=range(2)), tmp_path / "smaller" / "registry.json")
    with pytest.raises(LockError, match="as locked"):
        locked_entries(smaller, lock)
    without = publish_to(teams(), tmp_path / "without" / "registry.json", "v1")
    with pytest.raises(LockError, match="expected release v0"):
        locked_entries(without, lock)


def test_lock_has_one_release_and_whole_splits(registry: Registry, teams, publish_to) -> None:
    few = registry.select("scratch/ippo-d1-*")
    assert make_lock(registry, few).splits == {}
    with pytest.raises(LockError, match="left out"):
        make_lock(registry, few, {"scratch": registry.split("scratch").id})
    both = publish_to(teams(("mappo",)), registry.path, "v1")
    with pytest.raises(LockError, match="releases v0, v1"):
        make_lock(both, both.policies)


def test_a_lock_that_was_edited_or_damaged(registry: Registry, lock: Lock, tmp_path: Path) -> None:
    path = tmp_path / "assistax-zoo.lock"
    text = path.read_text()
    digest = lock.policies["scratch/ippo-d1-s0-v0/human"]
    for damage, message in (
        (text.replace(digest, "0" * 64), "it was edited"),
        (text.replace('"lock_version": 3', '"lock_version": 4'), "version 4"),
        (text.replace('"lock_version": 3', '"lock_version": 2'), "version 2"),
        (text.replace('"release"', '"relaese"'), "relaese|release"),
        (text[:-20], "JSONDecodeError"),
        ("[1]", "TypeError"),
        ("{}", "KeyError"),
    ):
        path.write_text(damage)
        with pytest.raises(LockError, match=message):
            read_lock(path)
    path.unlink()
    with pytest.raises(LockError, match="no such file"):
        read_lock(path)


def test_commands(registry: Registry, cache: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(registry.path))
    out = tmp_path / "paper.lock"
    assert run(["lock", "--out", str(out)]) == 0
    assert "locked 16 policies of release v0" in capsys.readouterr().out
    assert run(["lock", "scratch/ippo-d1-*", "--out", str(tmp_path / "few.lock"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["splits"] == {}
    source = str(registry.path.parent)
    assert run(["fetch", "--from", source, "--lock", str(tmp_path / "few.lock"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["policies"] == 8
    words = ["--task", "scratch", "zoo:scratch/ippo-d1-s0-v0/robot", "--lock", str(out)]
    assert run(["evaluate", *words, "--split", "scratch/small-5"]) == 1
    assert "expected the locked one" in capsys.readouterr().err
    without = registry.data.releases["v0"].model_copy(update={"splits": {}})
    data = registry.data.model_copy(update={"splits": (), "releases": {"v0": without}})
    registry.path.write_text(dump_registry(with_roots(data)))
    assert run(["evaluate", *words]) == 1
    assert "as locked, found none" in capsys.readouterr().err
    words = ["crossplay", "--task", "scratch", "--out", str(tmp_path / "xp"), "--lock", str(out)]
    assert run(words) == 1
    assert "as locked" in capsys.readouterr().err


def test_lock_pins_all_bytes_by_release_leaves(
    registry: Registry, lock: Lock, tmp_path: Path
) -> None:
    """Version 3: no digest stands twice in it but those that users cite."""
    text = json.loads((tmp_path / "assistax-zoo.lock").read_text())
    assert not {"shards", "disability_settings"} & set(text)
    tree = leaves(registry.data, "v0")
    assert lock.leaves == {name: digest for name, digest in tree.items() if name in lock.leaves}
    kinds = {name.partition(" ")[0] for name in tree} - {"release"}
    assert {name.partition(" ")[0] for name in lock.leaves} == kinds
    few = make_lock(registry, registry.select("scratch/ippo-d1-*/human"))
    assert {name.split()[0] for name in few.leaves} == {"team", "run", "setting", "shard"}
    pinned = [name for name in few.leaves if name.startswith("shard")]
    assert len(pinned) == len({entry.shard for entry in locked_entries(registry, few)})


def test_a_lock_of_robots_pins_the_persons_of_their_task(tmp_path: Path, capsys) -> None:
    """A lock of the care track is whole: robots, the table of persons, and their split."""
    registry, path = load_registry(), tmp_path / "care.lock"
    robots = registry.select("gentle_scratch/*")
    lock = make_lock(registry, robots)
    split = registry.split("gentle_scratch")
    assert lock.splits["gentle_scratch"].id == split.id and not lock.own_splits
    assert "persons gentle_scratch" in lock.leaves
    locked = apply_lock(registry, lock, task="gentle_scratch")
    assert locked.split("gentle_scratch") == split
    assert set(locked.data.releases[lock.release].persons) == {"gentle_scratch"}
    release = registry.data.releases[lock.release]
    table = release.persons["gentle_scratch"].model_copy(update={"sha256": "0" * 64})
    changed = {**release.persons, "gentle_scratch": table}
    other = release.model_copy(update={"persons": changed})
    data = registry.data.model_copy(update={"releases": {lock.release: other}})
    with pytest.raises(LockError, match=r"entry persons gentle_scratch .*, as locked"):
        apply_lock(build_registry(data, registry.path), lock, task="gentle_scratch")
    assert run(["lock", "gentle_scratch/person-0000*", "--out", str(path)]) == 1
    assert "lock the task's robots" in " ".join(capsys.readouterr().err.split())
