"""SIGTERM and SIGINT at any moment of a start: it ends soon, with one line, alone and whole."""

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest

from assistax_board.serve import open_service
from assistax_board.store.ledger import check_chain
from tests.board.running import port_of_its_own

ROOT = Path(__file__).parents[2]
STARTED = "_Server.main_loop"
SOON = 600.0  # seconds, also where many others use the machine
EARLY = 100  # calls, after which the program does not listen to signals yet
Moment = tuple[str, int, int]

# After how many calls of a function; where something is half done.
NAMED: list[Moment] = [
    ("load_signer", 5, signal.SIGTERM),
    ("create_app", 2000, signal.SIGTERM),
    ("Server.capture_signals", 1, signal.SIGINT),
    (STARTED, 0, signal.SIGTERM),
    *(("upgrade", calls, signal.SIGTERM) for calls in (500, 5000)),
    *(("local_workers", calls, signal.SIGTERM) for calls in (2, 5, 8, 12)),
]


def strike(folder: Path, moments: list[Moment]) -> tuple[int, list[str], int]:
    """Start a server, signal it; return its code, its lines and at which call it was struck."""
    mark, log = f"{folder}-{os.getpid()}", folder / "told"
    log.write_text("0")
    words = [json.dumps(moments), log, "serve", "--data", folder / "board"]
    words += ["--port", str(port_of_its_own())]
    done = subprocess.run(
        [sys.executable, "-m", "tests.board.signalled", *map(str, words)],
        cwd=ROOT,
        env={**os.environ, "ASSISTAX_MARK": mark},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        timeout=SOON,
    )
    assert left_alive(mark) == []
    return done.returncode, done.stderr.splitlines(), json.loads(log.read_text())


def left_alive(mark: str) -> list[str]:
    """Return who still runs of those that have this mark, after the second that they may take."""
    end = time.monotonic() + 60  # also where many others use the machine
    while processes := [path.name for path in Path("/proc").glob("[0-9]*") if _has(path, mark)]:
        if time.monotonic() > end:
            break
        time.sleep(0.1)
    return processes


def _has(process: Path, mark: str) -> bool:
    try:
        return f"ASSISTAX_MARK={mark}".encode() in (process / "environ").read_bytes()
    except OSError:
        return False


def check(code: int, lines: list[str], folder: Path) -> None:
    text = "\n".join(lines)
    assert "Traceback" not in text, text
    if code == 0:
        assert lines[-1] == "stopped", text
    elif code == 130:
        assert lines == ["error: interrupted"], text
    else:  # before the command was there, and Python with it
        assert (code, lines) == (-signal.SIGTERM, []), (code, text)
    service = open_service(folder / "board")
    with service.database.read() as connection:
        assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
    check_chain(service.queries.ledger())
    service.database.close()


@pytest.mark.slow
@pytest.mark.parametrize("moment", NAMED, ids=lambda moment: f"{moment[0]}-{moment[1]}")
def test_a_signal_where_something_is_half_done(tmp_path: Path, moment: Moment) -> None:
    code, lines, struck = strike(tmp_path, [moment])
    assert struck, "the function was never called"
    assert code == 0
    check(code, lines, tmp_path)


@pytest.mark.slow
def test_signals_at_random_moments_of_the_start(tmp_path: Path) -> None:
    rng = random.Random(0)
    (tmp_path / "whole").mkdir()
    calls = strike(tmp_path / "whole", [(STARTED, 0, signal.SIGTERM)])[2]
    assert calls > 100_000
    codes = []
    for trial in range(int(os.environ.get("ASSISTAX_STARTS", "20"))):
        folder = tmp_path / str(trial)
        folder.mkdir()
        moments = [
            ("", rng.randrange(calls), rng.choice([signal.SIGTERM, signal.SIGINT]))
            for _ in range(rng.choice([1, 1, 2]))
        ]
        if trial == 0:
            moments = [("", EARLY, signal.SIGTERM)]
        code, lines, struck = strike(folder, moments)
        assert struck
        check(code, lines, folder)
        codes.append(code)
    assert {0, 130, -signal.SIGTERM} <= set(codes), codes


def test_half_a_schema_would_be_found(tmp_path: Path) -> None:
    """The planted defect: what a kill left when every table was committed on its own."""
    (tmp_path / "board").mkdir()
    with sqlite3.connect(tmp_path / "board" / "service.db") as connection:
        connection.execute("CREATE TABLE submitters (id TEXT)")
    connection.close()
    with pytest.raises(Exception, match="already exists"):
        check(0, ["stopped"], tmp_path)
