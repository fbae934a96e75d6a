"""Random kills of server and workers: every submission ends, counts once, costs one attempt.

A kill is what SIGKILL leaves: a worker that never answers again, a server whose transaction is
rolled back and whose memory is gone. Both are struck at random database statements and at random
moments of a worker's job; the database file is opened anew each time.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import event

from assistax_board.rules import jobs
from assistax_board.rules.scoring import encode_table
from assistax_board.service import Service
from assistax_board.store.ledger import check_chain
from tests.board.fakes import FakeClock, FakeScorer, draft, new_service, new_submitter, work_off
from tests.board.test_faults_processes import losses
from tests.board.test_season import open_season


class KilledError(BaseException):
    """The process is gone; no handler of the service may catch it."""


class Fate:
    """Kills the process at a random statement, as often as it is told to.

    Never at every try of one job: that would fail, as it should (`jobs.MAX_FAILURES`), and whether
    chance strikes so often depends on how many statements a run happens to make.
    """

    def __init__(self, seed: int, kills: int) -> None:
        self._rng = np.random.default_rng(seed)
        self.left = kills
        self.in_a_row = 0  # kills since a job was done
        self._next = self._draw()

    def strike(self, *_: Any) -> None:
        self._next -= 1
        if self._next <= 0 and self.left > 0 and self.in_a_row < jobs.MAX_FAILURES - 1:
            self.left -= 1
            self.in_a_row += 1
            self._next = self._draw()
            raise KilledError

    def _draw(self) -> int:
        return int(self._rng.integers(1, 120))


def restart(folder: Path, fate: Fate, clock: FakeClock) -> Service:
    """Start a server on what is on the disk, and let fate watch its statements."""
    service = new_service(folder)
    object.__setattr__(service, "clock", clock)
    event.listen(service.database.engine, "before_cursor_execute", fate.strike)
    event.listen(service.database.engine, "commit", fate.strike)
    return service


@pytest.mark.parametrize(
    ("kills", "submissions"), [(12, 5), pytest.param(100, 50, marks=pytest.mark.slow)]
)
def test_kills_lose_nothing(tmp_path: Path, kills: int, submissions: int) -> None:
    clock, fate = FakeClock(), Fate(0, kills)
    service = new_service(tmp_path)
    season = open_season(service, budget=submissions)
    labs = [new_submitter(service, f"lab {n}") for n in range(3)]
    service = restart(tmp_path, fate, clock)
    data = ["broken" if n % 7 == 3 else f"robot {n}" for n in range(submissions)]
    todo = [(labs[n % 3], f"r{n}", data[n].encode()) for n in range(submissions)]
    struck, watcher = 0, new_service(tmp_path)  # the watcher is not part of what is killed
    while todo or _unfinished(watcher):
        try:
            if todo:
                lab, request, file = todo[0]
                service.submit(lab, draft(request=request, season=season, data=file))
                todo.pop(0)
            _work_once(service, fate)
            fate.in_a_row = 0
        except KilledError:
            struck += 1
            service.database.close()
            clock.now += jobs.LEASE_SECONDS + 1  # the time until somebody starts it again
            service = restart(tmp_path, fate, clock)
    assert struck > kills // 2  # the rest would have come later
    states, lost = losses(new_service(tmp_path), season, submissions)
    assert lost == [] and states.keys() == {"scored", "refused"}


def _work_once(service: Service, fate: Fate) -> None:
    """Do one job; fate may strike between any two of its steps."""
    work = service.lease("w", FakeScorer().versions())
    if work is None:
        return
    assert work.artefact is not None
    robot = service.artefacts.get(work.artefact)
    fate.strike()
    if robot == b"broken":
        service.job_refused(work.job, work.lease, "not_finite")
        return
    table = encode_table(FakeScorer().play(work, robot, None))
    fate.strike()
    service.result(work.job, work.lease, table, 1.0)
    fate.strike()  # the answer is lost: the worker sends the result again
    service.result(work.job, work.lease, table, 1.0)


def _unfinished(service: Service) -> bool:
    states = [row.state for row in service.queries.submissions(limit=1000)]
    return any(state in ("queued", "running") for state in states)


def test_endless_lease_would_lose_a_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The planted defect: leases that never end."""
    monkeypatch.setattr(jobs, "LEASE_SECONDS", 1e12)
    service = new_service(tmp_path)
    service.submit(new_submitter(service), draft())
    service.lease("killed", FakeScorer().versions())
    assert isinstance(service.clock, FakeClock)
    service.clock.now += 3600
    work_off(service)
    assert _unfinished(service)


KILLED = """
import sys
from pathlib import Path
from tests.board.fakes import *
service = new_service(Path(sys.argv[1]))
submitter = new_submitter(service, "lab")
number = 0
while True:
    service.submit(submitter, draft(request=f"r{number}"))
    print(number, flush=True)
    work_off(service, most=2)
    number += 1
"""


def test_what_was_answered_survives_sigkill(tmp_path: Path) -> None:
    """A real process with a real SIGKILL: whatever it had answered is there."""
    root = Path(__file__).parents[2]
    process = subprocess.Popen(
        [sys.executable, "-c", KILLED, str(tmp_path)], stdout=subprocess.PIPE, cwd=root, text=True
    )
    assert process.stdout is not None
    answered = [process.stdout.readline() for _ in range(3)]
    process.kill()
    process.communicate()
    service = new_service(tmp_path)
    assert len(service.queries.submissions()) >= len(answered)
    assert isinstance(service.clock, FakeClock)
    service.clock.now += jobs.LEASE_SECONDS + 1
    work_off(service)
    assert {row.state for row in service.queries.submissions()} == {"scored"}
    entries = service.queries.ledger()
    assert check_chain(entries) == len(entries)
