"""Logs played again: a true one gives its figures, and no changed one passes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from assistax_zoo.shell import main
from evaluation.people import log as log_file
from evaluation.people.log import LARGEST_LOG, LogError, read_log
from evaluation.people.playing import play
from evaluation.people.replaying import MOST_OFF, Refused, Replayed, replay_log, replay_logs
from tests.people.maker import make_log, signed, write
from tests.people.spoiling import spoiled
from zoo.registry import Registry


def test_a_true_log_gives_its_figures(
    with_robot: dict[str, Any], with_script: dict[str, Any], tmp_path: Path, registry: Registry
) -> None:
    logs = {"robot": with_robot, "script": with_script}
    paths = [write(content, tmp_path / f"{name}.json") for name, content in logs.items()]
    for outcome, content in zip(replay_logs(paths, registry), logs.values(), strict=True):
        assert isinstance(outcome, Replayed)
        assert outcome.off <= MOST_OFF
        assert outcome.figures["return"] == pytest.approx(content["result"]["return"], abs=1e-3)
        assert outcome.figures["success"] is content["result"]["success"]
        assert len(outcome.steps["reward"]) == outcome.figures["steps"] == content["steps"]


@pytest.mark.slow
def test_physics_are_those_of_the_recorded_episode(
    with_robot: dict[str, Any], registry: Registry, place: Path
) -> None:
    import jax

    from evaluation.people.playing import begun, drawn, environment, visitors

    one = read_log(write(with_robot, place))
    env, steps = environment(one.log.task), 300
    drawing = drawn(one.log.task, [one.log.start])
    state = begun(env, *drawing, visitors(one.log.task, [one.log.wish]))
    step, angles = jax.jit(env.step), []
    for robot, human, word in zip(one.robot, one.human, one.words, strict=True):
        acted = {"robot": robot[None], "human": human[None], "word": np.int32([word])}
        state = step(state, acted)
        angles.append(np.asarray(state.physics.qpos[0]))
        if len(angles) == steps:
            break
    again = play([one]).of(0)["qpos"][:steps]
    np.testing.assert_array_equal(np.stack(angles), again)  # to the bit


@pytest.mark.slow
def test_no_inconsistent_log_passes(
    with_robot: dict[str, Any], tmp_path: Path, registry: Registry
) -> None:
    changed = dict(spoiled(with_robot))
    assert len(changed) >= 200
    paths = [write(content, tmp_path / f"{i}.json") for i, content in enumerate(changed.values())]
    outcomes = dict(zip(changed, replay_logs(paths, registry), strict=True))
    assert [name for name, outcome in outcomes.items() if isinstance(outcome, Replayed)] == []
    for name, outcome in outcomes.items():
        assert isinstance(outcome, Refused)
        assert 20 < len(outcome.why) < 700 and "\n" not in outcome.why, (name, outcome.why)
        assert ";" in outcome.why, (name, outcome.why)  # what came and is allowed; what to do


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no JSON"),
        (b"[]", "format is 'list'"),
        (b"{}", "format is None"),
        (b"\xff\xfe", "no JSON"),
        (b'{"format": "assistax-seat 1", "format": "assistax-seat 1"}', "stands twice"),
        (b'{"format": NaN}', "NaN"),
        (b"[" * 100_000, "no JSON"),
        (b"1" * (LARGEST_LOG + 1), "more than 262144 bytes"),
        (b"[" + b"1," * 1000 + b"1]", "more than 500 values"),
    ],
)
def test_no_file_is_parsed_beyond_its_bounds(data: bytes, words: str, place: Path) -> None:
    place.write_bytes(data)
    with pytest.raises(LogError, match=words):
        read_log(place)


def test_a_folder_or_a_missing_file_is_no_log(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "nothing.json"):
        with pytest.raises(LogError, match="no file"):
            read_log(path)


def test_a_word_that_the_script_does_not_hear_changes_nothing(
    with_script: dict[str, Any], place: Path, registry: Registry
) -> None:
    """The limit that the docs state: what no figure depends on cannot be checked."""
    silent = signed({**with_script, "words": "AAAA" * 333 + "AA=="})
    assert replay_log(write(silent, place), registry).recorded.words.sum() == 0


def test_a_planted_change_of_the_engine_is_found(
    with_robot: dict[str, Any], place: Path, registry: Registry, monkeypatch
) -> None:
    """A body a little weaker, as another engine would have it, no longer fits the log."""
    from evaluation.people import playing

    monkeypatch.setattr(playing, "BODY", "d2")
    with pytest.raises(LogError, match="acts otherwise"):
        replay_log(write(with_robot, place), registry)


def test_the_command_says_what_it_found(
    with_robot: dict[str, Any], place: Path, capsys, monkeypatch
) -> None:
    write(with_robot, place)
    assert main.run(["replay", str(place)]) == 0
    assert "does not prove that a person played" in capsys.readouterr().out
    assert main.run(["replay", str(place), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["ok"] and answer["figures"]["steps"] == 1000
    write(signed({**with_robot, "start": 7}), place)
    assert main.run(["replay", str(place)]) == 1
    assert capsys.readouterr().err.startswith(f"error: {place}: from step 0 on its robot")


@pytest.mark.slow
@pytest.mark.parametrize(
    "task", ["gentle_bath", "gentle_lift", "gentle_feeding", "gentle_brushing"]
)
def test_logs_of_all_tasks_play_again(task: str, place: Path, registry: Registry) -> None:
    content = make_log(task, registry, robot=1, start=3, path=2)
    assert replay_log(write(content, place), registry).off <= MOST_OFF


def test_the_bounds_leave_room_for_a_whole_episode(with_robot: dict[str, Any], place: Path) -> None:
    size = write(with_robot, place).stat().st_size
    assert 2 * size < LARGEST_LOG
    assert with_robot["steps"] == log_file.STEPS
