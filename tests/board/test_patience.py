"""A check at home says what it does, and ends in one clear error when it takes too long."""

import threading
from pathlib import Path

import pytest

from assistax_board import submitting
from assistax_board.commands import submitting as commands
from assistax_board.robots import patience
from assistax_board.robots.patience import time_limit


def test_slow_work_is_told_of_and_ended(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patience, "SAY_SECONDS", 0.01)
    ended = threading.Event()
    with time_limit(0.2, "give more", ended.set) as say:
        say("looking at x")
        assert ended.wait(60)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "looking at x ..."
    assert lines[1].startswith("still looking at x: 0 of at most 0.2 s")
    assert lines[-1] == "error: looking at x took more than the time limit of 0.2 s; give more"


def test_fast_work_is_left_alone(capsys: pytest.CaptureFixture[str]) -> None:
    with time_limit(60.0, "give more", lambda: pytest.fail("ended")):
        pass
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan")])
def test_a_time_limit_is_positive(seconds: float) -> None:
    with pytest.raises(ValueError, match="allowed is a positive number"), time_limit(seconds, ""):
        pass


def test_the_option_reaches_the_check(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = []
    monkeypatch.setattr(
        submitting, "check_file", lambda *args, **options: asked.append(options) or {}
    )
    commands.submit(
        tmp_path / "a.onnx", task="scratch", at_home=commands.Check(check=True, check_seconds=5.0)
    )
    commands.submit(tmp_path / "a.onnx", task="scratch", at_home=commands.Check(check=True))
    assert [options["seconds"] for options in asked] == [5.0, submitting.CHECK_SECONDS]
