"""Progress of an evaluation: stages named and counted, on one clock."""

import os
import shutil
import sys
import time

import pytest

from assistax_zoo.shell import console
from assistax_zoo.shell.console import StudyLine, TrainingLine
from evaluation.play.progress import Progress, staged

SLOW = "still compiling; XLA may now warn of a very slow compile, which is no error"


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(console.time, "monotonic", clock)
    return clock


def test_stages_are_counted_on_one_clock(clock: Clock, capsys: pytest.CaptureFixture) -> None:
    with StudyLine("evaluate scratch") as line:
        for stage, what in ((1, "robots with humans"), (2, "reference robots")):
            shown = staged(line, stage, 2, what)
            assert shown is not None
            for done in (0, 1000, 2000, 4000):
                shown(Progress(done, 4000, 0.0))
                clock.now += 15.0
    assert capsys.readouterr().err.splitlines() == [
        "evaluate scratch, 1 of 2, robots with humans: compiling, 0 s",
        "evaluate scratch, 1 of 2, robots with humans: 1.00k of 4.00k steps, 15 s",
        "evaluate scratch, 1 of 2, robots with humans: 2.00k of 4.00k steps, 30 s, "
        "30 s left of this stage",
        "evaluate scratch, 1 of 2, robots with humans: 4.00k of 4.00k steps, 45 s",
        "evaluate scratch, 2 of 2, reference robots: compiling, 60 s",
        "evaluate scratch, 2 of 2, reference robots: 1.00k of 4.00k steps, 75 s",
        "evaluate scratch, 2 of 2, reference robots: 2.00k of 4.00k steps, 90 s, "
        "30 s left of this stage",
        "evaluate scratch, 2 of 2, reference robots: 4.00k of 4.00k steps, 105 s",
    ]


def test_a_line_that_changes_fits_the_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    size = os.terminal_size((40, 24))
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: size)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with StudyLine("evaluate scratch") as line:
        line(Progress(0, 4000, 0.0))
    text = "evaluate scratch, robots with humans: compiling, 0 s"[-39:]
    assert capsys.readouterr().err == f"\r{text}\x1b[K\n"


@pytest.mark.parametrize("kind", [StudyLine, TrainingLine])
def test_a_slow_compilation_is_no_error(
    kind: type, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(console, "SECONDS_OF_COMPILING", 0.01)
    with kind("scratch") as line:
        if kind is StudyLine:
            line(Progress(0, 4000, 0.0))
        until, printed = time.monotonic() + 10.0, ""
        while SLOW not in printed and time.monotonic() < until:
            time.sleep(0.01)
            printed += capsys.readouterr().err
    assert printed.count(f"{SLOW}\n") == 1


def test_a_quick_compilation_is_not_explained(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(console, "SECONDS_OF_COMPILING", 0.2)
    with StudyLine("evaluate scratch") as line:
        line(Progress(0, 4000, 0.0))
        line(Progress(1000, 4000, 0.0))
        time.sleep(0.4)
        line(Progress(0, 4000, 0.0, stage=2))
    time.sleep(0.4)  # nor after the work has ended
    assert SLOW not in capsys.readouterr().err
