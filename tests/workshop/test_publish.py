import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from assistax_base.errors import (
    FormatError,
    ImmutableError,
    LeakageError,
    PublishError,
    RegistryError,
)
from assistax_envs.registered import CARE, PAPER
from assistax_envs.versions import VERSIONS
from assistax_workshop.press.publish import publish
from assistax_workshop.press.release import complete_release
from assistax_workshop.press.trained_runs import read_run
from population.config import TrainConfig, make_members
from population.hyperparameters import PPOConfig
from population.networks.spec import PolicySpec
from population.networks.tensors import encode, flatten
from population.runs.folder import RunFolder
from population.runs.trained import TrainedTeam
from zoo.parameters.storage import load_stacks
from zoo.registry import Registry, load_registry
from zoo.splitting.create import create_split
from zoo.verify import verify

SELF_PLAY = {"mean": 950.5, "iqm": 952.25, "mean_ci": [940.0, 960.0], "n": 16, "success": 0.75}


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


def with_log_std(team: TrainedTeam, value: float, roles=("robot",)) -> dict[str, Any]:
    """Return the team's parameters, those of the roles changed."""
    changed = {
        role: {**team.params[role], "log_std": np.full_like(team.params[role]["log_std"], value)}
        for role in roles
    }
    return {**team.params, **changed}


def test_publication_is_complete_verified_and_repeatable(
    registry: Registry, teams, publish_to
) -> None:
    report = verify(registry)
    assert report.ok and not report.notes
    assert (report.shards, report.policies, report.splits) == (2, 16, 1)
    before = contents(registry.path.parent)
    assert set(before) == {"registry.json", *registry.data.shards}
    first = registry.policies[0]
    assert first.shard == f"zoo/shards/paper/scratch-ippo-robot-{first.spec.digest}.safetensors"
    assert [entry.row for entry in registry.select(role="robot")] == list(range(8))
    again = publish_to(teams(), registry.path, date="2030-12-24")
    assert again == registry and contents(registry.path.parent) == before


def test_bytes_do_not_depend_on_team_order(registry: Registry, teams, publish_to) -> None:
    before = contents(registry.path.parent)
    other = registry.path.parent / "other"
    publish_to(list(reversed(teams())), other / "registry.json")
    assert before.items() <= contents(other).items()


def test_a_growing_release_leaves_what_is_published(
    registry: Registry, teams, team, publish_to
) -> None:
    before = contents(registry.path.parent)
    split = registry.split("scratch")
    grown = publish_to(teams(("ippo", "mappo"), ("d1", "d9"), range(6)), registry.path)
    after = contents(registry.path.parent)
    assert all(after[name] == data for name, data in before.items() if name != "registry.json")
    assert sum(name.endswith("-2.safetensors") for name in after) == 2
    assert grown.policies[0].shard == registry.policies[0].shard and verify(grown).ok
    default = grown.split("scratch")
    assert default.id != split.id and grown.split("scratch", split.id) == split
    assert set(split.train) < set(default.train) and set(split.test) < set(default.test)
    entry = grown.policy("scratch/ippo-d9-s5-v0/human")
    expected = team("ippo", "d9", 5).params["human"]["log_std"]
    assert np.array_equal(load_stacks(grown, [entry])[0].params["log_std"][0], expected)


def test_incomplete_release_is_not_the_default(registry: Registry, teams, team, publish_to) -> None:
    nine = [
        team(seed=seed, params=with_log_std(team(), 0.25 + seed, ("robot", "human")))
        for seed in range(2)
    ]
    for part in nine:
        opened = publish_to([part], registry.path, "v1", complete=False)
    assert opened.release == "v0" and opened.splits == registry.splits
    assert not opened.data.releases["v1"].splits
    assert len(opened.select(release="v1", role="human")) == 2 and verify(opened).ok
    whole = complete_release(registry.path, "v1")
    assert whole.release == "v1" and len(whole.split("scratch").train) == 1
    before = contents(registry.path.parent)
    assert complete_release(registry.path, "v1") == load_registry(registry.path)
    complete_release(registry.path, "v0")  # an older one never becomes the default again
    assert contents(registry.path.parent) == before


def test_split_leaves_out_weak_partners_but_in_the_paper_track(
    registry: Registry, team, publish_to, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = {}
    # The bar is 23.75.
    for release, track, last in (("v2", PAPER, 1.0), ("v3", CARE, 24.0), ("v4", CARE, 23.0)):
        monkeypatch.setattr("zoo.splitting.create.track_of", lambda task, track=track: track)
        teams = [
            team(
                seed=seed,
                params=with_log_std(team(), seed + 0.01 * int(release[1]), ("robot", "human")),
                self_play={**SELF_PLAY, "mean": mean, "mean_ci": [mean, mean]},
            )
            for seed, mean in enumerate([100.0, 100.0, 90.0, last])
        ]
        publish_to(teams, registry.path, release, complete=False)
        whole = complete_release(registry.path, release, default=False)
        split = whole.split("scratch", release=release)
        found[release] = {name[-4] for name in (*split.train, *split.test)}
    assert whole.release == "v0" and set(whole.data.releases["v4"].splits) == {"scratch"}
    assert found == {"v2": {*"0123"}, "v3": {*"0123"}, "v4": {*"012"}}
    assert len(whole.select(release="v4", role="human")) == 4  # it stays in the release
    # By hand it is the same split; these teams differ in their noise alone, so it is refused.
    with pytest.raises(LeakageError, match=whole.data.releases["v4"].splits["scratch"]):
        create_split(registry.path, task="scratch", rule="half", release="v4")


def test_another_release_stands_beside_the_first(registry: Registry, team, publish_to) -> None:
    nine = team(
        params=with_log_std(team(), 0.25, ("robot", "human")),
        training={**team().training, "steps": 7},
    )
    two = publish_to([nine], registry.path, "v1", date="2028-02-29", description="longer")
    assert two.release == "v1" and two.data.releases["v1"].date == "2028-02-29"
    assert two.split("scratch", release="v0") == registry.split("scratch")
    assert two.policy("scratch/ippo-d1-s0-v1/robot").training.steps == 7
    assert any("no default split" in note for note in verify(two).notes)
    assert sorted(two.data.runs) == ["scratch-ippo", two.policy("scratch/ippo-d1-s0-v1/robot").run]


def test_changed_bytes_are_refused(registry: Registry, team, publish_to) -> None:
    before = contents(registry.path.parent)
    changed = team(params=with_log_std(team(), 0.5))
    with pytest.raises(ImmutableError, match=r"ippo-d1-s0-v0: expected the published sha256 "):
        publish_to([changed], registry.path)
    with pytest.raises(ImmutableError, match="self-play"):
        publish_to([team(self_play={**SELF_PLAY, "n": 8})], registry.path)
    with pytest.raises(ImmutableError, match="version 1 of scratch"):
        publish_to([team(seed=9)], registry.path, environments={"scratch": 2})
    fields = {name: {"robot": getattr(team(), name)["robot"]} for name in ("specs", "params")}
    with pytest.raises(ImmutableError):
        publish_to([team(**fields)], registry.path)
    assert contents(registry.path.parent) == before


def test_what_cannot_be_published_is_refused(registry: Registry, team, publish_to) -> None:
    before = contents(registry.path.parent)
    new = team(seed=9)
    cases = [
        ([], "at least one team"),
        ([new, new], "given twice"),
        ([team(seed=9, params=team().params)], "those of scratch/ippo-d1-s0-v0"),
        ([team(seed=9, training={"run": "r", "steps": 1})], "env_version"),
        ([team(seed=9, training={**new.training, "env_version": 2})], "version 1, found on 2"),
        ([team(seed=9, training={**new.training, "told": True})], "which no robot may observe"),
        ([team(seed=9, self_play={"mean": 1.0})], "iqm"),
        ([team(seed=9, self_play={**SELF_PLAY, "mean_ci": [2.0, 0.0]})], "low end"),
        ([team(seed=9, disability="d10")], "one of d1"),
        ([team(seed=9, task="ironing")], "task ironing"),
        (
            [team(seed=9, specs={**new.specs, "robot": PolicySpec("robot", 8, 2, hidden=(4,))})],
            "ippo-d1-s9-v0/robot: expected 5 observations and 2 actions.*found 8 and 2",
        ),
    ]
    for teams, words in cases:
        with pytest.raises(PublishError, match=words) as caught:
            publish_to(teams, registry.path)
        assert "\n" not in str(caught.value)
    lacking = {name: value for name, value in new.params["robot"].items() if name != "log_std"}
    with pytest.raises(FormatError, match="log_std"):
        publish([team(seed=9, params={**new.params, "robot": lacking})], registry.path, "v0")
    with pytest.raises(FormatError, match="NaN"):
        publish_to([team(seed=9, params=with_log_std(new, float("nan")))], registry.path)
    with pytest.raises(PublishError, match="2027-02-30"):
        publish_to([new], registry.path, date="2027-02-30")
    assert contents(registry.path.parent) == before


def test_team_needs_matching_specs_and_params(team) -> None:
    with pytest.raises(ValueError, match="give both by role"):
        team(params={"robot": team().params["robot"]})
    with pytest.raises(ValueError, match="is of role 'human'"):
        team(specs={"robot": team().specs["human"]}, params={"robot": team().params["human"]})


def test_unknown_provenance_is_kept_as_notes(tmp_path: Path, team, publish_to) -> None:
    training = {**team().training, "seed": 0, "seconds": 60.0}
    training["final"] = {"return": 950.0, "widths": [128, 128]}
    entry = publish_to([team(training=training)], tmp_path / "registry.json").policies[0]
    assert entry.training.notes == {"final.return": 950.0, "final.widths": "128,128"}
    assert entry.training.seconds == 60.0 and entry.run == "scratch-ippo"


def test_failure_before_registry_keeps_the_old_one(
    registry: Registry, team, publish_to, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(registry.path.parent)

    def fail(source, target):
        if Path(target).name == "registry.json":
            raise OSError(28, "No space left on device")
        replace(source, target)

    replace = os.replace
    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(OSError, match="No space"):
        publish_to([team("mappo")], registry.path)
    assert contents(registry.path.parent) == before


def test_kill_before_registry_keeps_the_old_one(registry: Registry, team, publish_to) -> None:
    text = registry.path.read_bytes()
    code = """
import os, runpy, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
sample = runpy.run_path(sys.argv[1])
replace = os.replace
def kill(source, target):
    if Path(target).name == "registry.json":
        os._exit(9)
    replace(source, target)
os.replace = kill
sample["put"]([sample["trained_team"]("mappo")], Path(sys.argv[3]))
"""
    root = Path(__file__).parents[2]
    arguments = [str(root / "tests/zoo/conftest.py"), str(root), str(registry.path)]
    assert subprocess.run([sys.executable, "-c", code, *arguments], check=False).returncode == 9
    assert registry.path.read_bytes() == text
    stray = sorted(registry.path.parent.rglob("scratch-mappo-*.safetensors"))
    report = verify(load_registry(registry.path))
    assert len(stray) == 2 and report.ok and "interrupted publication" in report.notes[0]
    # The next publication takes their place.
    assert verify(publish_to([team("mappo")], registry.path)).ok
    assert sorted(registry.path.parent.rglob("scratch-mappo-*.safetensors")) == stray


def test_two_publications_at_once_both_arrive(registry: Registry, team, publish_to) -> None:
    threads = [
        threading.Thread(target=publish_to, args=([team(algorithm)], registry.path))
        for algorithm in ("mappo", "isac", "masac")
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    after = load_registry(registry.path)
    assert {entry.algorithm for entry in after.policies} == {"ippo", "mappo", "isac", "masac"}
    assert verify(after).ok


def test_a_broken_registry_is_not_overwritten(tmp_path: Path, team, publish_to) -> None:
    path = tmp_path / "registry.json"
    path.write_text("{}")
    with pytest.raises(RegistryError):
        publish_to([team()], path)
    assert contents(tmp_path) == {"registry.json": b"{}"}


def write_run(folder: Path, teams: list[TrainedTeam], change=lambda items: None) -> Path:
    """Write teams as a trainer does."""
    folder.mkdir(parents=True)
    for role in ("robot", "human"):
        rows = [flatten(team.params[role]) for team in teams]
        stacked = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        metadata = {"spec": teams[0].specs[role].to_json(), "rows": list(range(len(teams)))}
        (folder / f"{role}.safetensors").write_bytes(encode(stacked, metadata))
    identity = ("task", "algorithm", "disability", "seed")
    items = [
        {
            "team": {name: getattr(team, name) for name in identity},
            "roles": {
                role: {"spec": spec.to_json(), "file": f"{role}.safetensors", "row": row}
                for role, spec in team.specs.items()
            },
            "training": {name: value for name, value in team.training.items() if name != "run"},
            "self_play": team.self_play,
        }
        for row, team in enumerate(teams)
    ]
    change(items)
    (folder / "teams.json").write_text(json.dumps(items))
    return folder


def test_run_folder_is_read_as_written(tmp_path: Path, teams, publish_to) -> None:
    for place in ("run-a", "run-b/final"):
        run = tmp_path / place.partition("/")[0]
        write_run(tmp_path / place, teams())
        direct = publish_to(teams(), run / "direct" / "registry.json")
        through = publish_to(read_run(run), run / "through" / "registry.json")
        assert [entry.sha256 for entry in direct.policies] == [
            entry.sha256 for entry in through.policies
        ]
        assert through.policies[0].run == run.name


def test_what_the_trainer_writes_can_be_published(tmp_path: Path, specs, params) -> None:
    members = make_members((0, 1), ("d1", "d9"))
    config = TrainConfig("scratch", "ippo", members, steps=100, trainer=PPOConfig(hidden=(4,)))
    rows = {
        role: [params(spec, 10 * n + len(role)) for n in range(4)] for role, spec in specs.items()
    }
    stacked = {
        role: jax.tree.map(lambda *leaves: np.stack(leaves), *trees) for role, trees in rows.items()
    }
    training = {"steps": 100, "env_version": 1, "backend": "native"}
    training["hyperparameters"] = config.to_json()["trainer"]
    run = RunFolder(tmp_path / "run")
    run.open(config, {"env_version": 1}, resume=False)
    run.write_teams(config, specs, stacked, training, [SELF_PLAY, SELF_PLAY, SELF_PLAY, None])
    registry = publish(read_run(run.folder), tmp_path / "registry.json", "v0")
    group = load_stacks(registry, registry.select(role="human"))[0]
    assert group.ids[-1] == "scratch/ippo-d9-s1-v0/human"
    assert np.array_equal(group.params["Dense_1"]["kernel"], stacked["human"]["Dense_1"]["kernel"])
    entry = registry.policy(group.ids[0])
    assert entry.training.hyperparameters["hidden"] == "4" and entry.self_play is not None


def robot_with(**fields: Any):
    return lambda items: items[0]["roles"]["robot"].update(fields)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda items: items.clear(), "at least one team"),
        (lambda items: items[0].pop("training"), "no 'training'"),
        (lambda items: items[0].update(roles=3), "AttributeError"),
        (robot_with(row=8), "a row from 0 to 7"),
        (robot_with(row=-1), "a row from 0 to 7"),
        (robot_with(file="../robot.safetensors"), "without a folder"),
        (robot_with(file="absent.safetensors"), "no such file"),
        (robot_with(file="human.safetensors"), "spec"),
        (lambda items: items[0]["roles"]["robot"]["spec"].update(torso="cnn"), "torso"),
    ],
)
def test_a_malformed_run_folder_is_refused(tmp_path: Path, teams, change, words: str) -> None:
    with pytest.raises(FormatError, match=words) as caught:
        read_run(write_run(tmp_path / "run", teams(), change))
    with pytest.raises(FormatError, match=r"teams\.json"):
        read_run(tmp_path)
    assert "\n" not in str(caught.value)


def test_persons_join_a_release_without_teams(tmp_path: Path) -> None:
    path = tmp_path / "registry.json"
    made = publish([], path, "v0", persons=["gentle_scratch"], date="2027-01-01")
    assert made.data.releases["v0"].environments == {"gentle_scratch": VERSIONS["gentle_scratch"]}
    assert made.split("gentle_scratch").rule == "persons" and verify(made).ok
    before = path.read_bytes()
    publish([], path, "v0", persons=["gentle_scratch"])
    assert path.read_bytes() == before
    with pytest.raises(PublishError, match="task nowhere: expected one of scratch"):
        publish([], path, "v0", persons=["nowhere"])
    with pytest.raises(PublishError, match="at least one team"):
        publish([], path, "v0")
