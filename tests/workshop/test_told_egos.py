"""Robots that are told the preference train with one side of a split, and play with both."""

import dataclasses
from pathlib import Path

import jax
import pytest

from assistax_envs import make
from assistax_zoo.shell.main import run as run_command
from evaluation.record import tables
from population.networks.spec import PolicySpec
from population.runs.folder import RunFolder
from tests import untrained
from tools.release_page.collect import collect
from zoo.registry import load_registry
from zoo.splitting.create import create_split


@pytest.mark.slow
def test_told_robots_learn_with_a_half_and_play_as_the_split_says(tmp_path: Path) -> None:
    task, env = "gentle_lift", make("gentle_lift", "native")
    robot, human = (
        PolicySpec(role, env.observation_size[role], env.action_size[role], hidden=(4,))
        for role in ("robot", "human")
    )
    teams = [
        dataclasses.replace(team, params=jax.tree.map(lambda leaf: 100 * leaf, team.params))
        for team in untrained.teams_of(2, robot, human, task)
    ]  # farther apart, so that no two act alike
    path = untrained.published(teams, tmp_path / "zoo")
    split = create_split(path, task=task, rule="half", test_preferences=["p1"], default=True)
    tiny = ("num_envs=4", "rollout_steps=8", "minibatches=1", "epochs=1", "hidden=(8,)")
    options = ["--seeds", "2", "--steps", "32", "--episodes", "9", "--backend", "native"]
    options += [word for change in tiny for word in ("--set", change)]
    folder = str(tmp_path / "told")
    assert run_command(["gates", "told-egos", task, folder, *options, "--registry", str(path)]) == 0
    run = RunFolder(tmp_path / "told" / "training").config()
    assert {name.rpartition("/")[0] for name in run.partners} == set(split.train)
    assert "p1" not in run.preferences and len(run.preferences) == 8
    summary = tables.read_json(tmp_path / "told" / "evaluation" / tables.SUMMARY_FILE)
    assert summary["engine"]["condition"] == "told" and summary["split"]["id"] == split.id
    assert summary["met"] == {"known": True, "source": "declared", "left_out": []}
    played = tables.read_episodes(tmp_path / "told" / "evaluation" / tables.EPISODES_FILE)
    liked = {side: set(rows["preference"]) for (side,), rows in played.group_by("side")}
    assert liked == {"train": set(run.preferences), "test": {"p1"}}
    assert load_registry(path).split(task).id == split.id
    filed = collect(tmp_path / "told" / "training", tmp_path / "v2", "ppo-told")
    assert filed == collect(tmp_path / "told" / "evaluation", tmp_path / "v2", "ppo-told")
    trained, run = (tables.read_json(filed / name) for name in ("training.json", "run.json"))
    assert (
        trained["egos"] == 2
        and "assistax-zoo gates told-egos" in trained["command"] == run["command"]
    )
