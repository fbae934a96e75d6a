"""`assistax-zoo train population`: toy environments under a real task's name, real training, a
registry of its own.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from assistax_zoo.shell.main import run
from tests.population.toy_env import ToyEnv, constant
from tests.workshop.test_publish import contents
from zoo.registry import load_registry
from zoo.verify import verify

ROOT = Path(__file__).parents[2]
TINY = {"num_envs": 4, "rollout_steps": 8, "minibatches": 2, "epochs": 1, "hidden": [4, 4]}
# Two members and the same shapes everywhere: one compilation serves every test.
ONE: dict[str, Any] = {"name": "toy-one", "task": "scratch", "algorithm": "ippo", "steps": 96}
ONE |= {"disabilities": ["d1"], "seeds": 2, "set": TINY, "self_play_episodes": 2}
OTHER = {**ONE, "name": "toy-other", "disabilities": ["d3"], "seeds": [0, 5]}


class ToyScratch(ToyEnv):
    task = "scratch"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a plan of two groups, and an environment that costs nothing and that nobody can
    improve in.
    """
    use_toy(monkeypatch)
    write_plan(tmp_path, ONE, OTHER)
    return tmp_path


def write_plan(place, *groups, release="v1"):
    plan = {"version": 1, "release": release, "groups": list(groups)}
    (place / "plan.json").write_text(json.dumps(plan))


def words(place, *more, out="runs"):
    return ["train", "population", "--plan", str(place / "plan.json"), "--out", str(place / out),
            "--registry", str(place / "registry.json"), *more]  # fmt: skip


def rows(capsys, place, *more):
    capsys.readouterr()
    assert run(words(place, "--dry-run", "--json", *more)) == 0
    return {row["group"]: row for row in json.loads(capsys.readouterr().out)["groups"]}


def groups_of(place):
    """Return the groups of the progress file."""
    return json.loads((place / "plan.progress.json").read_text())["groups"]


@pytest.mark.slow
def test_a_plan_is_trained_and_published_once(place, capsys):
    before = rows(capsys, place)
    assert (before["toy-one"]["missing"], before["toy-other"]["missing"]) == (2, 2)
    assert before["toy-one"]["estimated_from"] == "ippo", "at the speed of published teams"
    assert not (place / "runs").exists()

    assert run(words(place, "--curves", str(place / "curves"))) == 0
    registry = load_registry(place / "registry.json")
    assert [entry.team for entry in registry.policies[::2]] == [
        "scratch/ippo-d1-s0-v1", "scratch/ippo-d1-s1-v1", "scratch/ippo-d3-s0-v1",
        "scratch/ippo-d3-s5-v1",
    ]  # fmt: skip
    assert verify(registry).ok
    # Reward 1 a step whatever is done: nothing can be learned, and the teams are in the zoo with
    # what they earn.
    assert {entry.self_play and entry.self_play.mean for entry in registry.policies} == {8.0}

    progress = json.loads((place / "plan.progress.json").read_text())
    assert (progress["teams"], progress["published"]) == (4, 4)
    assert progress["groups"]["toy-other"]["state"] == "published"
    [toy_run] = progress["groups"]["toy-one"]["runs"].values()
    assert (toy_run["state"], toy_run["teams"], toy_run["steps"]) == ("published", 2, 96)
    assert (toy_run["seconds"], toy_run["steps_per_second"]) == (4.0, 2 * 96 / 4)

    curve = pl.read_parquet(place / "curves" / "toy-one.parquet")
    assert curve.columns[:6] == ["task", "algorithm", "disability", "seed", "steps", "return"]
    assert curve.filter(seed=1, disability="d1")["steps"].to_list() == [32, 64, 96]

    old = contents(place)
    assert run(words(place, "--curves", str(place / "curves"))) == 0
    assert contents(place) == old
    after = rows(capsys, place)["toy-one"]
    assert (after["published"], after["missing"], after["steps_to_train"]) == (2, 0, 0)


@pytest.mark.slow
def test_finished_run_is_published_without_checkpoints(place, monkeypatch, capsys):
    write_plan(place, OTHER)
    assert run(words(place, "--no-publish")) == 0
    assert not (place / "registry.json").exists()
    waiting = rows(capsys, place)["toy-other"]
    assert (waiting["trained"], waiting["published"], waiting["steps_to_train"]) == (2, 0, 0)
    progress = groups_of(place)["toy-other"]
    assert (progress["state"], progress["published"]) == ("trained", 0)
    assert progress["device_minutes"] >= 0
    for path in (place / "runs" / "toy-other" / "checkpoints").rglob("*"):
        if path.is_file():
            path.unlink()
    monkeypatch.setattr("assistax_envs.make", unwanted)
    parameters = (place / "runs" / "toy-other" / "robot.safetensors").read_bytes()
    assert run(words(place)) == 0
    assert rows(capsys, place)["toy-other"]["published"] == 2
    assert (place / "runs" / "toy-other" / "robot.safetensors").read_bytes() == parameters


@pytest.mark.slow
def test_release_becomes_default_when_plan_is_complete(place):
    assert run(words(place, "--groups", "toy-one")) == 0
    part = load_registry(place / "registry.json")
    assert len(part.policies) == 4 and not part.splits
    assert run(words(place)) == 0
    whole = load_registry(place / "registry.json")
    split = whole.split("scratch")
    assert {*split.train, *split.test} == set(whole.data.teams) and len(whole.splits) == 1


@pytest.mark.slow
def test_interrupted_run_resumes_with_its_own_config(place, monkeypatch, capsys):
    """The folder holds two members of four; its configuration stands, whatever the plan says
    meanwhile.
    """
    group = {**ONE, "disabilities": ["d1", "d9"], "max_members": 2, "checkpoint_every": 1}
    write_plan(place, group)
    interrupt_after(monkeypatch, updates=2)
    assert run(words(place)) == 130
    monkeypatch.undo()
    use_toy(monkeypatch)
    begun = json.loads((place / "runs" / "toy-one" / "config.json").read_text())
    assert groups_of(place)["toy-one"]["state"] == "training"

    write_plan(place, {**group, "steps": 64, "disabilities": ["d9", "d1"]})
    assert run(words(place)) == 0
    assert "not as the plan says: steps is 96 there and 64 here" in capsys.readouterr().err
    assert json.loads((place / "runs" / "toy-one" / "config.json").read_text()) == begun
    trained = {
        entry.team: entry.training.steps
        for entry in load_registry(place / "registry.json").policies
    }
    assert trained == {
        "scratch/ippo-d1-s0-v1": 96, "scratch/ippo-d1-s1-v1": 96,
        "scratch/ippo-d9-s0-v1": 64, "scratch/ippo-d9-s1-v1": 64,
    }  # fmt: skip


@pytest.mark.slow
def test_adopted_teams_keep_parameters_and_provenance(place, monkeypatch, capsys):
    """The runs of both releases have one name and one duration: they are still told apart."""
    write_plan(place, ONE, release="v0")
    assert run(words(place, out="old")) == 0
    group = {**ONE, "disabilities": ["d1", "d9"], "adopt": "v0"}
    write_plan(place, group)
    row = rows(capsys, place)["toy-one"]
    assert (row["adoptable"], row["missing"], row["estimated_from"]) == (2, 2, "ippo")
    assert run(words(place)) == 0
    registry = load_registry(place / "registry.json")
    for seed in (0, 1):
        old, new = (registry.team(f"scratch/ippo-d1-s{seed}-{release}") for release in ("v0", "v1"))
        hashes = [{role: row.sha256 for role, row in team.policies.items()} for team in (old, new)]
        assert hashes[0] == hashes[1]
        assert (old.run, old.self_play) == (new.run, new.self_play) and old.policies != new.policies
    assert verify(registry).ok
    runs = groups_of(place)["toy-one"]["runs"]
    assert {run["state"]: run["teams"] for run in runs.values()} == {"adopted": 2, "published": 2}
    write_plan(place, {**group, "steps": 97}, release="v2")
    assert rows(capsys, place)["toy-one"]["adoptable"] == 0  # trained for 96 steps


@pytest.mark.slow
def test_parameters_of_another_team_are_still_refused(place):
    """The defect that the check is for: a run folder whose rows are another team's."""
    write_plan(place, OTHER)
    assert run(words(place)) == 0
    teams = json.loads((place / "runs" / "toy-other" / "teams.json").read_text())
    for team in teams:
        team["team"]["disability"] = "d4"
    copy = place / "runs" / "toy-other-2"
    copy.mkdir()
    for name in ("robot.safetensors", "human.safetensors"):
        shutil.copy(place / "runs" / "toy-other" / name, copy)
    (copy / "teams.json").write_text(json.dumps(teams))
    write_plan(place, {**OTHER, "disabilities": ["d3", "d4"]})
    before = (place / "registry.json").read_bytes()
    assert run(words(place, "--no-train")) == 1
    assert (place / "registry.json").read_bytes() == before


def test_one_failure_leaves_the_other_groups_alone(place, capsys):
    # Episodes have 8 steps.
    write_plan(place, {**ONE, "set": {**TINY, "rollout_steps": 9, "num_envs": 2}}, OTHER)
    assert run(words(place, "--json")) == 1
    captured = capsys.readouterr()
    published = {row["group"]: row["published"] for row in json.loads(captured.out)["groups"]}
    assert published == {"toy-one": 0, "toy-other": 2}
    assert "error: 1 failed, and the same command tries again: toy-one:" in captured.err
    groups = groups_of(place)
    assert [groups[name]["state"] for name in ("toy-one", "toy-other")] == ["failed", "published"]
    [failed] = groups["toy-one"]["runs"].values()
    assert "rollout_steps is 9" in failed["error"]


@pytest.mark.slow
def test_locked_run_is_left_to_its_process(place, monkeypatch, capsys):
    """A real process holds the lock, as on another GPU; once it is killed, the run is free."""
    script = (
        "import pathlib, time; from assistax_base.files import exclusive\n"
        f"with exclusive(pathlib.Path({str(place / 'runs' / 'toy-other')!r})):\n"
        "    print('held', flush=True); time.sleep(60)"
    )
    write_plan(place, OTHER)
    with subprocess.Popen(
        [sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout and other.stdout.readline() == "held\n"
        with monkeypatch.context() as patch:
            patch.setattr("assistax_envs.make", unwanted)
            assert run(words(place)) == 0
        other.kill()
        other.wait()
    assert rows(capsys, place)["toy-other"]["missing"] == 2
    assert run(words(place)) == 0
    assert rows(capsys, place)["toy-other"]["published"] == 2


@pytest.mark.slow
def test_progress_file_keeps_other_processes_runs(place):
    write_plan(place, OTHER)
    assert run(words(place, "--no-publish", out="here")) == 0
    write_plan(place, ONE, OTHER)
    assert run(words(place, "--groups", "*-one", out="there")) == 0
    states = {name: group["state"] for name, group in groups_of(place).items()}
    assert states == {"toy-one": "published", "toy-other": "trained"}


def test_a_plan_that_adopts_needs_the_registry(place, capsys):
    write_plan(place, {**ONE, "adopt": "v0"})
    assert run(words(place, "--no-publish")) == 1
    assert "adopts teams of release v0, but there is no registry" in capsys.readouterr().err
    assert run(words(place, "--groups", "swim")) == 1
    assert "no group matches 'swim'; the plan has toy-one" in capsys.readouterr().err


def test_train_stays_a_command_of_its_own(capsys):
    assert run(["train", "--task", "swim", "--out", "x"]) == 1
    assert "task is 'swim'; allowed are scratch" in capsys.readouterr().err
    assert run(["train", "population", "--out", "x"]) == 2
    assert capsys.readouterr().err.endswith("try: assistax-zoo train population --help\n")


def use_toy(monkeypatch):
    """Train on a toy in 4 seconds, whatever the machine."""
    monkeypatch.setattr("population.runs.train.round", lambda seconds, digits: 4.0, raising=False)
    monkeypatch.setattr(
        "assistax_envs.make",
        lambda task, backend, version=None: ToyScratch(constant, episode_length=8),
    )


def unwanted(task, backend, version=None):
    raise AssertionError("nothing was to be trained")


def interrupt_after(monkeypatch, updates):
    """Interrupt training as Ctrl-C does, after a number of updates."""
    from assistax_zoo.shell.console import TrainingLine

    def stop(self, progress):
        if progress.update >= updates:
            raise KeyboardInterrupt

    monkeypatch.setattr(TrainingLine, "__call__", stop)
