"""A server under load: readers of its pages, labs that submit and watch, and losses.

The server is the real one, in its own process; a worker beside it returns made-up results at once,
so that the server is measured and not the physics. Times are those of clients; on a machine that
does other work too, the server's CPU time for a request is the steadier figure.
"""

import dataclasses
import multiprocessing
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2

from assistax_board.client import Client
from assistax_board.robots.limited import resident_bytes
from benchmarks.pages import PageSpeed, read_pages

TASK, ROBOT = "scratch", "scratch/ippo-d1-s0-v1/robot"
LOST_SECONDS = 600.0  # for which a lab retries
LAST_SECONDS = 90.0  # for memory to fall again
FIRST = 5  # submissions on the board before the load begins
SPAWN = multiprocessing.get_context("spawn")


@dataclasses.dataclass(frozen=True)
class ServiceSpeed:
    """Work of a server under load."""

    pages: list[PageSpeed]
    submitted: int
    lost: int  # submissions that were not scored in the end
    seconds_to_score: float  # mean, from submission until a client sees the score
    requests: int
    server_cpu_ms: float  # of the server's process, for one request of any kind
    load: tuple[float, float]  # of the machine, before and after


def measure_service(readers: int, submitters: int, seconds: float) -> ServiceSpeed:
    """Return the figures of a new server that readers and submitters use for a while."""
    from assistax_board.serve import open_service

    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="assistax-zoo-") as folder:
        with serving(Path(folder)) as started:
            address = started[1]
            service = open_service(Path(folder))
            work = service.create_token(("work",), label="made up")
            tokens = [
                service.create_token(("submit",), submitter=f"lab {n}") for n in range(submitters)
            ]
            worker = SPAWN.Process(target=work_made_up, args=(address, work), daemon=True)
            worker.start()
            _submit_all(address, tokens[:FIRST], 0.0)
            read_pages(address, 1, 1.0)  # computed pages are cached before the measurement
            answers: Any = SPAWN.Queue()
            args = (address, tokens, seconds, answers)
            crowd = SPAWN.Process(target=_submit_all, args=args, daemon=True)
            crowd.start()
            cpu, count = _work_of(*started)
            pages = read_pages(address, readers, seconds)
            handed_in, times = answers.get(timeout=600)
            cpu, count = _work_of(*started)[0] - cpu, _work_of(*started)[1] - count
            worker.terminate()
        states = [submission.state for submission in service.queries.submissions(limit=100_000)]
        service.database.close()
    return ServiceSpeed(
        pages,
        handed_in + FIRST,
        handed_in + FIRST - states.count("scored"),
        sum(times) / max(1, len(times)),
        count,
        1000 * cpu / max(1, count),
        (before, os.getloadavg()[0]),
    )


@contextmanager
def serving(folder: Path, database: str | None = None) -> Generator[tuple[Any, str]]:
    """Run the server of a folder, or of another database; yield its process and its address."""
    log = folder / ".log"  # `serve` takes no folder with other files, but for hidden ones
    words = ["serve", "--data", str(folder), "--port", "0", "--workers", "0", "--no-references"]
    words += ["--database", database] if database else []
    with log.open("w") as file:
        process = subprocess.Popen([sys.executable, "-m", "assistax_zoo", *words], stderr=file)
    try:
        address = ""
        while process.poll() is None and not address:
            time.sleep(0.1)
            line = log.read_text().split()
            address = line[1] if len(line) > 1 else ""
        Client(address).call("GET", "/api/health")  # retries until there is an answer
        yield process, address
    finally:
        process.terminate()
        process.wait()


def work_made_up(address: str, token: str) -> None:
    """Return made-up results for every job, without end."""
    import numpy as np
    import polars as pl

    from assistax_board.rules.catalogue import ZooCatalogue, version_id
    from assistax_board.rules.scoring import encode_table
    from zoo.registry import load_registry

    client, rng = Client(address, token), np.random.default_rng(0)
    versions = (version_id(ZooCatalogue(load_registry(), "fused").identity(TASK)),)
    while True:
        work = client.lease("made up", versions)
        if work is None:
            time.sleep(0.2)
            continue
        rows = [(name, k) for name in work.partners for k in range(work.episodes)]
        table = pl.DataFrame(
            {
                "partner": [name for name, _ in rows],
                "algorithm": [name.split("/")[1].split("-")[0] for name, _ in rows],
                "disability": [name.split("-")[1] for name, _ in rows],
                "episode": [k for _, k in rows],
                "return": rng.normal(900, 50, len(rows)),
                "success": [True] * len(rows),
                "nonfinite": [False] * len(rows),
            }
        )
        client.result(work, encode_table(table), 0.1)


class Peak:
    """Peak memory of a process and its children, watched by a thread."""

    def __init__(self, pid: int) -> None:
        self._pid, self._over = pid, threading.Event()
        self.most = self.last = memory_of(pid)
        threading.Thread(target=self._look, daemon=True).start()

    def _look(self) -> None:
        while not self._over.wait(0.5):
            self.last = memory_of(self._pid)
            self.most = max(self.most, self.last)

    def wait_for(self, bytes_: float) -> float:
        """Return the seconds until at most `bytes_` are in use; stops the watch."""
        began = time.monotonic()
        while self.last > bytes_ and time.monotonic() - began < LAST_SECONDS:
            time.sleep(0.5)
        self._over.set()
        return time.monotonic() - began


def memory_of(pid: int) -> float:
    """Return the bytes of a process and its children."""
    children = Path(f"/proc/{pid}/task/{pid}/children")
    total = float(resident_bytes(pid))
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            total += sum(memory_of(int(child)) for child in task.read_text().split())
    return total if children.exists() else 0.0


def _submit_all(
    address: str, tokens: list[str], seconds: float, answers: Any = None
) -> tuple[int, list[float]]:
    """Let labs submit robots and watch each to its end; return their number and seconds."""
    from assistax_board.submitting import POLL_SECONDS, read_file
    from assistax_board.vocabulary import FINAL_STATES

    robot, end, times = read_file(Path(ROBOT)), time.monotonic() + seconds, []

    def lab(number: int) -> None:
        count = 0
        client = Client(address, tokens[number], patience=LOST_SECONDS)
        time.sleep(seconds * number / len(tokens) / 4)  # starts are spread
        while count == 0 or time.monotonic() < end:
            began, fields = time.monotonic(), {"task": TASK, "method": f"robot {count}"}
            request = f"request-{seconds}-{count}"
            id = client.submit(robot, request_id=request, **fields)["id"]
            while client.submission(id)["state"] not in FINAL_STATES:
                time.sleep(POLL_SECONDS)
            times.append(time.monotonic() - began)
            count += 1
            time.sleep(5.0 if seconds else 0.0)

    threads = [threading.Thread(target=lab, args=(n,)) for n in range(len(tokens))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if answers is not None:
        answers.put((len(times), times))
    return len(times), times


def _work_of(process: Any, address: str) -> tuple[float, int]:
    """Return the CPU seconds that a server has used, and the requests that it answered."""
    return _cpu(process.pid), _requests(address)


def _cpu(pid: int) -> float:
    """Return the CPU seconds that a process has used."""
    ticks = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")


def _requests(address: str) -> int:
    """Return the number of requests that a server answered."""
    text = httpx2.get(f"{address}/metrics", timeout=60).text
    lines = [line for line in text.splitlines() if line.startswith("assistax_service_requests_tot")]
    return round(sum(float(line.rpartition(" ")[2]) for line in lines))
