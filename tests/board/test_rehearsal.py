"""A whole tiny season by one command, and what would make it fail."""

import contextlib
import itertools
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Generator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import sqlalchemy as sa

from assistax_board.rehearsal import disk, postgres, season, stage
from assistax_board.rehearsal.disk import full_disk, small_disk
from assistax_board.rehearsal.hardships import fill_disk
from assistax_board.service import Service
from assistax_board.store.ledger import check_chain
from assistax_board.store.schema import JOB
from assistax_zoo.shell.main import run
from tests.attack.test_faults import mounted
from tests.board.fakes import FakeScorer, draft, ends, new_submitter, state_of
from tests.board.faulty import real_service
from tests.board.running import port_of_its_own
from tests.board.test_faults_processes import JOBS, ROOT, Process
from tests.board.test_season import open_season


@pytest.mark.slow
@pytest.mark.parametrize("is_bare", [False, True], ids=["all", "bare"])
def test_a_season_is_rehearsed(
    is_bare: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Also where nothing can be mounted and PostgreSQL is not installed, which it says."""
    if is_bare:
        monkeypatch.setattr(disk, "SMALL", "size=nothing")
        monkeypatch.setattr(season, "missing", lambda: "PostgreSQL is not installed")
    data = tmp_path / "rehearsal"
    words = ["season", "rehearse", "--data", str(data)]
    assert run(words) == 0, capsys.readouterr().err
    lines = capsys.readouterr().out
    assert re.findall(r"stage (\d) of 9, ", lines) == list("123456789")
    assert lines.count("panel B: ") == 2
    for text in (
        *("trained 4 hidden teams", "trained 4 public teams", "drew 4 hidden persons"),
        *("Lab of Ada handed in robot.safetensors", "Lab of Grace handed in robot.onnx"),
        "upgraded while the season is open: fused plays anew what native scored",
        *("rolled back: the board shows native's own", "nothing is played twice"),
        *("the closing date came", "killed the server while the season closes"),
        *("a server on native does not start", "proved: the 8 partners", "are a chain"),
        *("a backup has", "has stopped", "all is as it should be"),
    ):
        assert text in lines
    left_out = re.findall("left out: (.+)", lines)
    hard = ("the disk has room again", "rows to postgresql", "rows to sqlite")
    if is_bare:
        assert left_out[1:] == ["PostgreSQL is not installed"] and "needs root" in left_out[0]
        assert not any(text in lines for text in hard)
    else:
        can = (os.getuid() == 0, *2 * [postgres.missing() is None])
        assert [text in lines for text in hard] == list(can)
    assert (data / "board.zip").is_file() and (data / "board" / "signing-key.pem").is_file()
    assert run(words) == 1 and "exists; name a new folder" in capsys.readouterr().err


@pytest.mark.slow
def test_season_survives_full_disk_kill_upgrade(tmp_path: Path) -> None:
    """The disk is a real one of 32 MB where a file system may be mounted."""
    with mounted(tmp_path / "board", "size=32m") as is_real:
        closes_through_all(tmp_path / "board", is_real)


def closes_through_all(folder: Path, is_real: bool) -> None:
    """Let a season close on a disk that is full twice; see that nothing is lost."""
    url, port = f"sqlite:///{folder / 'service.db'}", port_of_its_own()
    service = real_service(folder, url)
    season = open_season(service, budget=8, closes_at=time.time() + 60.0)
    ids = handed_in(service, season)
    server = Process("serve", folder, url, port)
    work = service.create_token(("work",))
    workers = [Process("work", f"http://127.0.0.1:{port}", work) for _ in range(2)]
    try:
        disk = folder if is_real else folder / "full"
        until(lambda: is_open(service) and not waiting(service), "panel A is played", disk=disk)
        for process in (server, *workers):
            process.kill()
        server = Process("serve", folder, url, port, 2)
        workers = [Process("work", f"http://127.0.0.1:{port}", work, 2) for _ in range(2)]
        until(
            lambda: is_open(service) and played(service, 2) == JOBS * len(ids),
            "panel A is played anew",
        )
        until(lambda: state_of(service) == "closing", "the closing date comes")
        server.kill()
        assert state_of(service) == "closing", "killed too late to tell"
        words = ("serve", folder, url, port, 3)
        upgraded = subprocess.run(
            [sys.executable, "-m", "tests.board.faulty", *map(str, words)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert upgraded.returncode and "season spring is closing" in upgraded.stderr
        server.start()
        until(lambda: state_of(service) == "closed", "all is revealed", disk=disk)
        server.kill()
    finally:
        for process in (server, *workers):
            process.kill()
    assert {ends(service, id) for id in ids} == {("scored", "spent")}
    assert {id for id, _ in service.panel_b(season)} == set(ids)
    entries = service.queries.ledger()
    assert check_chain(entries) == len(entries)
    on_b = service.queries.scores(season=season, panel="B")
    assert {score.version for score in on_b} == set(FakeScorer(2).versions())
    assert real_service(folder, url, 3).adopt_version() == len(ids), "the upgrade comes after it"


def handed_in(service: Service, season: str) -> list[str]:
    """Hand in two methods of two seeds for each of two labs, and enter them."""
    ids = []
    for lab in ("Ada", "Grace"):
        submitter = new_submitter(service, lab)
        for n in range(4):
            fields = {"season": season, "method": f"{lab} {n % 2}"}
            ids.append(service.submit(submitter, draft(float(n), f"{lab} {n}", **fields)))
        service.enter(season, submitter, ids[-4:])
    return ids


def until(is_so: Callable[[], bool], what: str, disk: Path | None = None) -> None:
    """Wait until something is so; meanwhile the disk is full for some seconds."""
    end = time.monotonic() + 300.0
    if disk is not None:
        time.sleep(1.0)
        with full_disk(disk) if disk.is_dir() else touched(disk):
            time.sleep(4.0)
    while not is_so():
        assert time.monotonic() < end, f"in vain: {what}"
        time.sleep(0.02)


@contextlib.contextmanager
def touched(path: Path) -> Generator[None]:
    """Let a server that looks for this file find no room; see `faulty`."""
    path.touch()
    yield
    path.unlink()


def waiting(service: Service) -> list[str]:
    rows = service.queries.submissions(limit=1000)
    return [row.id for row in rows if row.state in ("queued", "running")]


def played(service: Service, version: int) -> int:
    """Return how many jobs were done by a version."""
    [name] = FakeScorer(version).versions()
    with service.database.read() as connection:
        done = sa.select(sa.func.count()).where(JOB.version == name, JOB.state == "done")
        return connection.execute(done).scalar_one()


def is_open(service: Service) -> bool:
    """Keep a season open however slow this machine is, and say that it is."""
    [season] = service.queries.seasons()
    if (season.closes_at or 0.0) < time.time() + 30.0:
        service.extend_season(season.name, time.time() + 60.0)
    return True


def test_what_never_happens_ends_a_rehearsal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage, "LIMIT_SECONDS", 0.0)
    with pytest.raises(ValueError, match="in vain: the moon falls"):
        list(stage.wait("the moon falls", lambda: False))


def test_a_rehearsal_says_how_far_a_submission_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    states = [("queued", 0), ("running", 0), ("running", 0), ("running", 1), ("scored", 2)]
    rows = iter([{"state": state, "jobs_done": done, "jobs": 2} for state, done in states])
    client: Any = SimpleNamespace(submission=lambda id: next(rows))
    lines = list(stage.watch(client, "7kq2"))
    assert lines == [
        "7kq2 is queued: 0 of 2 jobs done",
        "7kq2 is running: 0 of 2 jobs done",
        "7kq2 is running: 1 of 2 jobs done",
    ]


def test_a_long_job_is_no_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = itertools.count(0.0, 40.0)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    monkeypatch.setattr(time, "monotonic", lambda: next(seconds))
    row = {"state": "running", "jobs_done": 0, "jobs": 2}
    client: Any = SimpleNamespace(submission=lambda id: row)
    lines: list[str] = []
    with pytest.raises(ValueError, match="30 minutes in vain: 7kq2 ends"):
        lines += stage.watch(client, "7kq2")
    watching = stage.watch(client, "7kq2")
    assert [next(watching) for _ in range(3)] == ["7kq2 is running: 0 of 2 jobs done"] * 3
    waiting = stage.wait("the moon falls", lambda: False)
    assert [next(waiting) for _ in range(3)] == ["waiting: the moon falls"] * 3


def test_a_small_disk_is_kept_when_it_goes(tmp_path: Path) -> None:
    folder = tmp_path / "board"
    with small_disk(folder) as is_small:
        assert is_small == (folder.stat().st_dev != tmp_path.stat().st_dev)
        (folder / "kept").write_text("kept")
        if is_small:
            with full_disk(folder), pytest.raises(OSError, match="No space left"):
                (folder / "more").write_bytes(bytes(10_000))
            (folder / "more").write_bytes(bytes(10_000))
    assert (folder / "kept").read_text() == "kept"
    assert folder.stat().st_dev == tmp_path.stat().st_dev
    assert folder.stat().st_mode & 0o077 == 0
    assert [path.name for path in tmp_path.iterdir()] == ["board"]


def test_a_disk_that_cannot_be_mounted_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "SMALL", "size=nothing")
    with small_disk(tmp_path / "board") as is_small:
        assert not is_small and (tmp_path / "board").is_dir()
    board: Any = None
    assert list(fill_disk(board, is_small)) == [
        "left out: no file system of its own may be mounted here (it needs root)"
    ]
