"""A job has a budget: what takes more is refused with a word, and the worker goes on without it."""

import mmap
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.rules.scoring import Work
from assistax_board.service import Service
from assistax_board.work.worker import Budget, Worker
from tests.board.fakes import FakeScorer, draft, new_submitter, shown, work_off
from tests.board.test_season import open_season

MIB = 1024 * 1024


class Greedy(FakeScorer):
    """Plays a robot until it is stopped, in which it takes processors or memory."""

    def __init__(self, takes: str) -> None:
        super().__init__()
        self.takes, self.stopped = takes, threading.Event()

    def play(self, work: Work, robot: Any, release: bytes | None) -> Any:
        kept, end = [], time.monotonic() + 30
        while not self.stopped.is_set() and time.monotonic() < end:
            if self.takes == "memory" and len(kept) < 300:
                # Pages of its own: `bytes` would take what the process has and does not use.
                kept.append(mmap.mmap(-1, MIB))
                kept[-1].write(b"x" * MIB)
            elif self.takes == "clock":
                time.sleep(0.01)
        return super().play(work, robot, release)


def work_with(service: Service, takes: str, **budget: Any) -> list[str]:
    """Let a worker meet one greedy robot; return how often it began anew."""
    scorer, anew = Greedy(takes), []
    http = TestClient(create_app(service), raise_server_exceptions=False)
    client = Client("", service.create_token(("work",)), transport=http)

    def begin_anew() -> None:
        anew.append("anew")
        scorer.stopped.set()

    worker = Worker(client, scorer, budget=Budget(**budget), restart=begin_anew)
    worker.run(until_empty=True)
    return anew


@pytest.mark.parametrize(
    ("takes", "budget"),
    [
        ("seconds", {"seconds": 0.5}),
        ("clock", {"clock_seconds": 0.5}),
        ("memory", {"memory": 100 * MIB}),
    ],
)
def test_a_robot_that_takes_more_is_too_slow(service: Service, takes: str, budget: Any) -> None:
    id = service.submit(new_submitter(service), draft())
    assert work_with(service, takes, **budget) == ["anew"]
    assert (shown(service, id).state, shown(service, id).reason) == ("refused", "too_slow")


@pytest.mark.parametrize(("met", "attempt"), [(0, "refunded"), (3, "spent")])
def test_too_slow_on_hidden_partners_spends_attempt(
    service: Service, met: int, attempt: str
) -> None:
    id = service.submit(new_submitter(service), draft(season=open_season(service)))
    work_off(service, most=met)
    work_with(service, "clock", clock_seconds=0.5)
    submission = shown(service, id)
    assert (submission.reason, submission.attempt) == ("too_slow", attempt)


def test_restarted_worker_runs_the_same_command() -> None:
    code = "import sys; sys.argv = ['worker', '--version']; import assistax_board"
    code += ".work.working_process as w; w._start_anew()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout[0].isdigit()
