"""Progress of an evaluation: stages named and counted, on one clock."""

import os
import shutil
import sys

import pytest

from assistax_zoo.shell import console
from assistax_zoo.shell.console import StudyLine
from evaluation.play.progress import Progress, staged


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
