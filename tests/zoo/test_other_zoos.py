"""Another zoo beside one's own: `add`, its ids everywhere, `remove`; and what is fetched when."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from assistax_base.digest import sha256
from assistax_base.errors import (
    IdError,
    ImmutableError,
    IntegrityError,
    RemoteError,
    SplitError,
    UnknownIdError,
    UpdateError,
)
from assistax_workshop.press.publish import publish
from assistax_zoo.shell.main import run
from assistax_zoo.zoos import open_zoo
from evaluation.cast.cast import choose_partners, in_release
from population.runs.trained import TrainedTeam
from tests.zoo.hub_server import Hub
from zoo.history.merkle import with_roots
from zoo.locations import added_remote, default_remote, set_default_remote
from zoo.lock import apply_lock, read_lock
from zoo.locking import make_lock
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, load_registry
from zoo.saving import check_grown, dump_registry
from zoo.splitting.create import create_split
from zoo.transport.addresses import open_remote
from zoo.transport.fetch import fetch, remote_registry
from zoo.transport.other_zoos import add, remove
from zoo.verify import verify


@pytest.fixture
def lab(registry: Registry, team, publish_to, tmp_path: Path, cache: Path, monkeypatch) -> Registry:
    """Somebody's zoo with a team of the same id as one of ours, and an ego; ours is the default."""
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("ASSISTAX_ZOO_REGISTRY", str(registry.path))
    theirs = team(params={role: _moved(params) for role, params in team().params.items()})
    return publish_to([theirs, ego(team)], tmp_path / "lab" / "registry.json")


def _moved(params: dict) -> dict:
    return {**params, "log_std": params["log_std"] + 1}


def ego(team, seed: int = 0) -> TrainedTeam:
    """A robot as `train-ego` leaves it."""
    robot = team("ppo", seed=seed)
    return TrainedTeam(
        task="scratch",
        algorithm="ppo",
        disability="mixed",
        seed=seed,
        specs={"robot": robot.specs["robot"]},
        params={"robot": robot.params["robot"]},
        training=robot.training,
        trained_against={"split": "scratch/half-s0-v0-f4c7b97d", "sha256": "a" * 64},
    )


def test_ego_is_published_and_never_a_partner(registry: Registry, team) -> None:
    before = registry.split("scratch")
    check = {"check": lambda spec, leaves, source: None}
    grown = publish([ego(team)], registry.path, "v0", **check)
    [entry] = grown.select("scratch/ppo-ego-*")
    assert (entry.id, entry.disability) == ("scratch/ppo-ego-s0-v0/robot", "ego")
    assert entry.setting is None and entry.self_play is None and entry.trained_against is not None
    assert grown.split("scratch") == before and verify(grown).ok
    assert publish([ego(team)], registry.path, "v0", **check) == grown
    with pytest.raises(ValueError, match="is an ego"):
        _ = entry.partner_setting
    stack = load_stacks(grown, [entry])[0]
    assert np.array_equal(stack.row(0)["log_std"], team("ppo").params["robot"]["log_std"])


@pytest.mark.parametrize("kind", ["folder", "hub"])
def test_their_policies_stand_beside_ours(
    kind: str, lab: Registry, registry: Registry, hub: Hub, capsys
) -> None:
    hub.put("me/my-zoo", lab.path.parent)
    remote = "hf://me/my-zoo" if kind == "hub" else str(lab.path.parent)
    assert run(["add", remote, "--as", "lab"]) == 0
    assert "fetch 'lab:*'" in capsys.readouterr().out
    both = load_registry()
    assert len(both.policies) == len(registry.policies) + 3
    theirs = both.policy("lab:scratch/ippo-d1-s0-v0/human")
    assert theirs.sha256 != both.policy("scratch/ippo-d1-s0-v0/human").sha256
    assert both.env_version(theirs) == 1 and both.team(theirs.team).self_play == theirs.self_play
    assert both.root("lab:v0") == lab.root("v0") and both.root("v0") == registry.root("v0")
    assert [e.id for e in both.select("lab:*ego*")] == ["lab:scratch/ppo-ego-s0-v0/robot"]
    assert both.select("scratch/*") == registry.policies  # a glob of ours takes none of theirs
    with pytest.raises(IntegrityError, match=r"no file at .*next: `assistax-zoo fetch`"):
        load_stacks(both, both.select("lab:scratch/ippo-*"))
    assert run(["fetch", "lab:*"]) == 0
    assert fetch(both, both.select("lab:*")).bytes == 0
    assert [stack.ids for stack in load_stacks(both, [theirs])] == [(theirs.id,)]
    assert run(["show", "lab:scratch/ppo-ego-s0-v0/robot"]) == 0
    assert "trained_against" in capsys.readouterr().out
    assert load_registry(registry.path).policies == registry.policies  # a named one stands alone
    assert run(["remove", "lab"]) == 0 and load_registry().policies == registry.policies
    with pytest.raises(UnknownIdError, match="none of that name"):
        remove("lab")


def test_their_splits_and_locks_are_theirs(
    lab: Registry, registry: Registry, teams, publish_to
) -> None:
    publish_to(teams(("mappo",)), lab.path)
    ours = make_lock(registry, registry.policies)
    add(str(lab.path.parent), "lab")
    both = load_registry()
    split = both.split("scratch", release="lab:v0")
    assert split.id.startswith("lab:scratch/half-s0-v0") and split in both.splits
    assert both.split("scratch", split.id) == split != both.split("scratch")
    for word in ("lab:", "lab:half-s0", "lab:scratch/half"):
        assert both.split("scratch", word) == split
    for word in ("lab:both", "lab:half-s0:both", f"{split.id}:both"):  # as `--split` takes it
        manifest, chosen = choose_partners(both, "scratch", word, None)
        assert manifest == split
        assert {member.team for member in chosen} == {*split.train, *split.test}
    assert all(team.startswith("lab:") and team in both.data.teams for team in split.train)
    assert both.split("scratch") == registry.split("scratch")
    alone = apply_lock(both, ours, task="scratch")  # a lock from before the zoo was added
    assert alone.policies == registry.policies and alone.root("v0") == ours.root
    with pytest.raises(SplitError, match="lab:scratch/half"):
        alone.split("scratch", split.id)
    lock = make_lock(both, both.select(release="lab:v0", algorithm="mappo"))
    assert lock.root == both.root("lab:v0")
    narrowed = apply_lock(both, lock, task="scratch")
    assert {entry.team.partition(":")[0] for entry in narrowed.policies} == {"lab"}


def test_added_zoo_is_followed_but_not_rewritten(
    lab: Registry, team, teams, publish_to, cache: Path
) -> None:
    add(str(lab.path.parent), "lab")
    publish_to(teams(("mappo",), seeds=range(1)), lab.path)
    assert len(add(str(lab.path.parent), "lab", take_all).policies) == 7
    lab.path.unlink()
    publish_to([team()], lab.path)
    for path in (cache / "registries").rglob("registry.json"):
        path.unlink()  # even where the cache was deleted
    with pytest.raises(IntegrityError, match="another history"):
        add(str(lab.path.parent), "lab")
    assert len(load_registry().select("lab:*")) == 7
    with pytest.raises(IdError, match="namespace"):
        add(str(lab.path.parent), "My Lab")


def take_all(changes: Sequence[str]) -> bool:
    return True


def one_partner(registry: Registry) -> None:
    """Give the registry a default split with one partner a side, as its owner may."""
    teams = [e.team for e in registry.policies if e.role == "human"]
    sides = {"train": teams[:1], "test": teams[1:2]}
    create_split(registry.path, task="scratch", rule="custom", default=True, **sides)


def test_another_default_split_is_shown_and_asked_for(
    lab: Registry, teams, publish_to, capsys
) -> None:
    publish_to(teams(("mappo",)), lab.path)
    remote = str(lab.path.parent)
    add(remote, "lab")
    address = f"file://{remote}"
    open_zoo(address)
    before = load_registry().split("scratch", "lab:")
    one_partner(load_registry(lab.path))
    warning = r"default split of scratch in v0 is .*custom.* \(1 train, 1 test\), was scratch/half"
    with pytest.raises(UpdateError, match=warning):
        add(remote, "lab")
    with pytest.raises(UpdateError, match=warning):
        remote_registry(open_remote(remote))
    with pytest.raises(UpdateError, match=warning):
        open_zoo(address)
    assert open_zoo(address, accept_changes=True).registry.split("scratch").rule == "custom"
    for words in (["add", remote, "--as", "lab"], ["fetch", "--from", remote]):
        assert run(words) == 1
        assert "(1 train, 1 test)" in capsys.readouterr().err
    assert load_registry().split("scratch", "lab:") == before
    add(remote, "lab", take_all)
    assert load_registry().split("scratch", "lab:").rule == "custom"
    publish_to(teams(("isac",)), lab.path, "v1")
    assert run(["add", remote, "--as", "lab", "--yes"]) == 0
    assert "the default release is v1, was v0" in capsys.readouterr().err


def test_zoo_from_elsewhere_is_asked_for(lab: Registry, tmp_path: Path) -> None:
    add(str(lab.path.parent), "lab")
    shutil.copytree(lab.path.parent, tmp_path / "moved")
    with pytest.raises(UpdateError, match=r"comes from .*moved, not from"):
        add(str(tmp_path / "moved"), "lab")
    assert added_remote("lab") == str(lab.path.parent)
    add(str(tmp_path / "moved"), "lab", take_all)
    assert added_remote("lab") == str(tmp_path / "moved")


def test_another_environment_version_is_another_history(lab: Registry) -> None:
    remote = str(lab.path.parent)
    add(remote, "lab")
    record = lab.data.releases["v0"].model_copy(update={"environments": {"scratch": 7}})
    forged = with_roots(lab.data.model_copy(update={"releases": {"v0": record}}))
    lab.path.write_text(dump_registry(forged))
    with pytest.raises(IntegrityError, match="another history: version 1 of scratch in v0"):
        add(remote, "lab", take_all)
    with pytest.raises(ImmutableError, match="version 1 of scratch in v0"):
        check_grown(lab.data, forged)
    assert load_registry().data.releases["lab:v0"].environments == {"scratch": 1}


def test_glob_locks_and_cross_plays_their_teams(
    lab: Registry, teams, publish_to, tmp_path: Path
) -> None:
    publish_to(teams(("mappo",)), lab.path)
    publish_to(teams(("isac",)), lab.path, "v1")
    add(str(lab.path.parent), "lab")
    out = tmp_path / "lab.lock"
    assert run(["lock", "lab:*", "--out", str(out)]) == 0
    lock = read_lock(out)
    assert lock.release == "lab:v1" and lock.registry == sha256(lab.path.read_bytes())
    assert lock.splits["scratch"].id.startswith("lab:scratch/half-s0-v1")
    assert run(["lock", "lab:*", "--release", "lab:v0", "--out", str(out)]) == 0
    assert read_lock(out).release == "lab:v0"
    both = load_registry()
    for release, expected in ((None, "lab:v1"), ("v0", "lab:v0"), ("lab:v0", "lab:v0")):
        entries = in_release(both, "lab:*", release, task="scratch", role="robot")
        assert {entry.release for entry in entries} == {expected}


def test_the_default_remote_is_set_once(
    registry: Registry, lab: Registry, tmp_path: Path, monkeypatch
) -> None:
    bare = tmp_path / "wheel" / "registry.json"
    bare.parent.mkdir()
    bare.write_bytes(registry.path.read_bytes())
    installed = load_registry(bare)
    [problem] = verify(installed).problems  # one line, not one for each shard
    assert "all 2 shards are missing" in problem and "assistax-zoo fetch" in problem
    with pytest.raises(RemoteError, match="config remote"):
        fetch(installed, installed.policies)
    assert run(["config", "remote", str(registry.path.parent)]) == 0
    assert default_remote() == str(registry.path.parent)
    monkeypatch.setenv("ASSISTAX_ZOO_REMOTE", "hf://org/zoo")
    assert default_remote() == "hf://org/zoo"
    monkeypatch.delenv("ASSISTAX_ZOO_REMOTE")
    done = fetch(installed, installed.policies, open_remote(default_remote() or ""))
    assert done.bytes > 0 and verify(installed).ok
    assert fetch(installed, installed.policies).present == 2
    set_default_remote(None)
    assert default_remote() is None
    assert json.loads((tmp_path / "data/config.json").read_text()) == {}
