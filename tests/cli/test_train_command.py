import json

import polars as pl
import pytest

from assistax_workshop.press.trained_runs import read_run
from assistax_zoo.commands.options import parse_changes, parse_seeds, parse_steps
from assistax_zoo.shell.console import TrainingLine
from assistax_zoo.shell.main import run
from population.runs.train import Progress

TINY = ["--set", "rollout_steps=8", "--set", "minibatches=2", "--set", "hidden=(8, 8)"]
TINY += ["--num-envs", "4", "--self-play-episodes", "0"]


@pytest.mark.parametrize(
    ("text", "steps"),
    [("250000", 250_000), ("500k", 500_000), ("10M", 10**7), ("1.5e6", 1_500_000)],
)
def test_steps_are_read_with_units(text, steps):
    assert parse_steps(text) == steps


@pytest.mark.parametrize("text", ["", "0", "-5", "_", "ten", "10X", "nan", "inf", "1e99"])
def test_bad_steps_say_what_is_allowed(text):
    with pytest.raises(ValueError, match="give a number above 0, such as 500k, 10M or 2e7"):
        parse_steps(text)


@pytest.mark.parametrize(
    ("text", "seeds"), [("3", [0, 1, 2]), ("0-2", [0, 1, 2]), ("2,5", [2, 5]), ("0-1,7", [0, 1, 7])]
)
def test_seeds_are_a_number_or_a_list(text, seeds):
    assert parse_seeds(text) == seeds


@pytest.mark.parametrize("text", ["", "0", "a", "3-1", "1,1", "-2", "1,,2"])
def test_bad_seeds_say_what_is_allowed(text):
    with pytest.raises(ValueError, match="give how many, such as 8, or which"):
        parse_seeds(text)


def test_hyperparameters_are_read_as_values():
    changes = parse_changes(
        ["learning_rate=3e-4", "torso=gru", "anneal_lr=true", "hidden=(64, 64)"]
    )
    assert changes == {"learning_rate": 3e-4, "torso": "gru", "anneal_lr": True, "hidden": (64, 64)}
    with pytest.raises(ValueError, match="give name=value"):
        parse_changes(["gru"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--task swim", "task is 'swim'; allowed are scratch"),
        ("--algorithm sac", "algorithm is 'sac'; allowed are ippo, mappo, isac, masac, mep"),
        ("--disability d1,d10", "disability is 'd10'; allowed are d1, d2"),
        ("--steps 0", "steps is '0'"),
        ("--num-envs 7", "choose num_envs as a multiple of minibatches"),
        ("--set speed=9", "unknown hyperparameter speed of ippo; allowed are"),
    ],
)
def test_wrong_values_get_one_line(words, message, tmp_path, capsys):
    task = [] if "--task" in words else ["--task", "scratch"]
    assert run(["train", *task, *words.split(), "--out", str(tmp_path / "run")]) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1 and message in captured.err
    assert not (tmp_path / "run").exists()


def test_training_line_has_no_time_before_an_episode_ends(capsys):
    """The first update counts compilation, so it promises no time."""
    line = TrainingLine("scratch ippo")
    rows = pl.DataFrame({"return": [None], "reward": [0.5]}, schema_overrides={"return": float})
    line(Progress(1, 4, 500_000, 2_000_000, 37.0, None, rows))
    assert capsys.readouterr().err == (
        "scratch ippo: 500.00k of 2.00M steps, reward 0.50 a step, no whole episode yet\n"
    )
    rows = pl.DataFrame({"return": [480.25, None], "reward": [0.5, 0.5]})
    line = TrainingLine("scratch ippo")
    line(Progress(3, 4, 1_500_000, 2_000_000, 15_200.4, 33.0, rows))
    assert capsys.readouterr().err == (
        "scratch ippo: 1.50M of 2.00M steps, 15,200 steps/s, return 480.2, 33 s left\n"
    )


@pytest.mark.slow
def test_a_tiny_run_on_the_real_task_can_be_published(tmp_path, capfd):
    words = ["train", "--task", "scratch", "--disability", "d1,d9", "--seeds", "0,4", *TINY]
    words += ["--steps", "96"]
    members = [("d1", 0), ("d1", 4), ("d9", 0), ("d9", 4)]
    assert run([*words, "--out", str(tmp_path / "run"), "--json-lines"]) == 0
    lines = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    assert [line["update"] for line in lines[:-1]] == [1, 2, 3]
    assert [team["seed"] for team in lines[-1]["teams"]] == [0, 4, 0, 4]
    teams = read_run(tmp_path / "run")
    assert [(team.disability, team.seed) for team in teams] == members
    assert teams[0].specs["robot"].observation_size == 34
    events = tmp_path / "events"
    assert run([*words, "--out", str(tmp_path / "run"), "--json", "--log", str(events)]) == 0
    assert len(json.loads(capfd.readouterr().out)["teams"]) == 4
    expected = [f"scratch-ippo-{setting}-s{seed}" for setting, seed in members]
    assert sorted(path.name for path in events.iterdir() if any(path.iterdir())) == expected
    assert run([*words, "--out", str(tmp_path / "other"), "--log", str(events)]) == 1
    assert "holds event files of another run" in capfd.readouterr().err
    assert not (tmp_path / "other").exists()
