"""What a user makes: own teams and splits stand beside the official ones, which nobody changes."""

import json
import shutil
from pathlib import Path

import pytest

from assistax_base.errors import IdError, PublishError, RegistryError, SplitError, UnknownIdError
from assistax_workshop.press.release import complete_release
from assistax_zoo.shell.main import run
from tests.cli.test_zoo_commands import write_run
from zoo.history.official import is_official
from zoo.history.own_splits import SplitsFile
from zoo.locations import own_registry, own_splits_file
from zoo.lock import apply_lock, read_lock
from zoo.locking import make_lock, write_lock
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, load_registry
from zoo.saving import MAKER_VARIABLE, save_registry
from zoo.splitting.create import create_split
from zoo.transport.fetch import fetch
from zoo.transport.other_zoos import add, remove

SMALL = {"task": "scratch", "rule": "small-train", "n": 1}


@pytest.fixture
def official(registry: Registry, tmp_path: Path, cache: Path, monkeypatch) -> Registry:
    """The registry of the test as the one that came with the code; the user made nothing yet."""
    for variable in ("ASSISTAX_ZOO_REGISTRY", MAKER_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "data"))
    for module in ("zoo.history.official", "zoo.locations"):
        monkeypatch.setattr(f"{module}.shipped_registry", lambda: registry.path)
    return registry


def test_an_own_split_leaves_the_official_registry_and_its_root(official: Registry) -> None:
    before, root = official.path.read_bytes(), official.root("v0")
    split = create_split(**SMALL)
    now = load_registry()
    assert official.path.read_bytes() == before and now.root("v0") == root
    assert now.split("scratch", "small") == split and now.split("scratch") != split
    assert create_split(**SMALL) == split and len(load_registry().splits) == 2
    lock = make_lock(now, now.policies, {"scratch": split.id})
    assert lock.root == root and lock.splits["scratch"].id == split.id
    assert load_registry(official.path).splits == official.splits  # a named one stands alone


def test_lock_carries_the_own_split(official: Registry, tmp_path: Path) -> None:
    split = create_split(**SMALL)
    now = load_registry()
    write_lock(make_lock(now, now.policies, {"scratch": split.id}), tmp_path / "paper.lock")
    own_splits_file().unlink()
    lock = read_lock(tmp_path / "paper.lock")
    narrowed = apply_lock(load_registry(), lock, task="scratch", split="small-1")
    assert narrowed.split("scratch") == split
    moved = split.model_copy(update={"train": split.test, "test": split.train})
    forged = lock.model_copy(update={"own_splits": (moved,)})
    with pytest.raises(SplitError, match="sha256"):
        apply_lock(load_registry(), forged, task="scratch")


def test_commands_find_own_splits_and_teams(official: Registry, tmp_path: Path, capsys) -> None:
    before, folder = official.path.read_bytes(), write_run(tmp_path / "run")
    assert run(["split", "create", "--task", "scratch", "--rule", "small-train", "--n", "1"]) == 0
    assert run(["publish", str(folder), "--release", "v0", "--json"]) == 0
    document = capsys.readouterr().out
    published = json.loads(document[document.index("{") :])
    assert published["registry"] == str(own_registry())
    assert all(id.startswith("own:scratch/") for id in published["added"])
    assert run(["list", "own:*"]) == 0
    assert f"{len(published['added'])} policies" in capsys.readouterr().out
    out = tmp_path / "own.lock"
    assert run(["lock", "--task", "scratch", "--split", "small-1", "--out", str(out)]) == 0
    assert "split scratch/small-1" in capsys.readouterr().out
    assert run(["cite", "--lock", str(out)]) == 0
    cited = capsys.readouterr().out
    assert f"root {official.root('v0')}" in cited and "split scratch/small-1" in cited
    assert run(["lock", "--split", "small-1", "--out", str(out)]) == 1
    assert "TASK/small-1" in capsys.readouterr().err
    own = load_registry()
    assert fetch(own, own.select("own:*")).bytes == 0
    assert load_stacks(own, own.select("own:*"))
    assert official.path.read_bytes() == before


def test_own_teams_have_splits_of_their_own(official: Registry, teams, publish_to) -> None:
    publish_to(teams(("mappo",)), own_registry())
    default = load_registry().split("scratch", "own:")
    other = create_split(task="scratch", release="own:v0", seed=1)
    now = load_registry()
    assert other != default and other in now.splits and now.split("scratch", other.id) == other
    assert all(team.startswith("own:scratch/mappo-") for team in (*other.train, *other.test))
    sides = {"train": [other.train[0]], "test": [other.test[0]]}
    custom = create_split(task="scratch", release="own:v0", rule="custom", **sides)
    assert (custom.train, custom.test) == ((other.train[0],), (other.test[0],))
    sides["train"] = [other.train[0].partition(":")[2]]  # of the same name, and not the user's own
    with pytest.raises(SplitError, match="official scratch/mappo"):
        create_split(task="scratch", release="own:v0", rule="custom", **sides)
    assert now.root("v0") == official.root("v0")


def test_copy_of_official_registry_is_read_only(
    official: Registry, teams, publish_to, tmp_path: Path, monkeypatch, capsys
) -> None:
    copy = tmp_path / "elsewhere" / "mine.json"
    shutil.copytree(official.path.parent / "zoo", copy.parent / "zoo")
    shutil.copy(official.path, copy)
    publish_to(teams(("mappo",)), tmp_path / "other.json", "v1")
    attempts = [
        lambda: create_split(copy, **SMALL),
        lambda: publish_to(teams(("mappo",)), copy, "v1"),
        lambda: save_registry(load_registry(copy).data, copy),
    ]
    before = copy.read_bytes()
    for attempt in attempts:
        with pytest.raises(PublishError, match="found releases of this project"):
            attempt()
    assert complete_release(copy, "v0").data == official.data  # whole already: nothing to write
    assert copy.read_bytes() == before
    words = ["split", "create", "--task", "scratch", "--seed", "1"]
    assert run([*words, "--registry", str(copy)]) == 1
    assert "a registry of your own" in capsys.readouterr().err
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(copy))
    create_split(**SMALL)
    assert copy.read_bytes() == before and own_splits_file().is_file()
    monkeypatch.setenv(MAKER_VARIABLE, "1")
    attempts[0]()
    attempts[1]()
    assert is_official(load_registry(official.path).data) and copy.read_bytes() != before


def test_a_registry_of_a_lab_stays_writable(
    official: Registry, teams, publish_to, tmp_path: Path, monkeypatch
) -> None:
    lab = publish_to(teams(("mappo",)), tmp_path / "lab" / "registry.json")
    split = create_split(lab.path, **SMALL)
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(lab.path))
    other = create_split(task="scratch", seed=1)
    splits = load_registry(lab.path).splits
    assert split in splits and other in splits
    assert not own_splits_file().exists()


def test_own_splits_never_stand_for_others(
    official: Registry, teams, publish_to, tmp_path: Path, monkeypatch
) -> None:
    split = create_split(**SMALL)
    with pytest.raises(SplitError, match="expected the published one"):
        create_split(**SMALL, default=True)
    lab = publish_to(teams(), tmp_path / "lab" / "registry.json", "v0", date="2027-02-01")
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(lab.path))
    assert split not in load_registry().splits  # teams of the same names, and not the official ones
    monkeypatch.delenv("ASSISTAX_ZOO_REGISTRY")
    monkeypatch.setenv(MAKER_VARIABLE, "1")
    assert create_split(**SMALL) == split  # the same split, published later
    assert load_registry().splits.count(split) == 1
    forged = split.model_copy(update={"sha256": "0" * 64})
    own_splits_file().write_text(SplitsFile(splits=(forged,)).model_dump_json())
    with pytest.raises(SplitError, match="an official split of this id"):
        load_registry()
    own_splits_file().write_text("{")
    with pytest.raises(RegistryError, match="own splits"):
        load_registry()


def test_name_of_own_zoo_is_reserved(official: Registry, teams, publish_to, tmp_path: Path) -> None:
    lab = publish_to(teams(("mappo",)), tmp_path / "lab" / "registry.json")
    for taken in ("own", "zoo", "python", "onnx"):  # `zoo:ID` would be another robot in `evaluate`
        with pytest.raises(IdError, match="user's own zoo or a kind of robot"):
            add(str(lab.path.parent), taken)
    publish_to(teams(("mappo",)), own_registry())
    with pytest.raises(UnknownIdError, match="may hold the only copy"):
        remove("own")
    assert own_registry().is_file()


def test_the_shipped_registry_is_official() -> None:
    assert is_official(load_registry(Path(__file__).parents[2] / "registry.json").data)
