"""SIGKILL of real processes, PostgreSQL's too, while robots are submitted and scored.

Whatever is killed, and whenever: every submission ends, none is counted twice, no attempt is lost.
`failed` is no loss if it is by design, a job that died with its worker at all its tries; everything
else that is not a score or a refusal is.
"""

import contextlib
import functools
import json
import os
import random
import statistics
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from assistax_board.client import Client
from assistax_board.rules import jobs
from assistax_board.rules.catalogue import PUBLIC_SEED, panel_episodes
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.ledger import check_chain
from assistax_board.store.schema import ENTRY, JOB, RESULT, SCORE, SUBMISSION
from assistax_board.vocabulary import FINAL_STATES
from tests.board.fakes import (
    FakeCatalogue,
    draft,
    fail_next_job,
    new_service,
    new_submitter,
    noise,
    scored,
)
from tests.board.faulty import PATIENCE, real_service
from tests.board.postgres import Cluster
from tests.board.running import port_of_its_own
from tests.board.test_season import open_season

ROOT = Path(__file__).parents[2]
JOBS = 3 + 2  # public panel, panel A
LABS, WORKERS = 5, 3


class Process:
    """A process that is started again whenever it was killed."""

    def __init__(self, *words: Any) -> None:
        self._words = [sys.executable, "-m", "tests.board.faulty", *map(str, words)]
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen(self._words, cwd=ROOT, stderr=subprocess.DEVNULL)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def look(self) -> None:
        """Start it again if it went by itself, as a server does that finds no database."""
        if self._process.poll() is not None:
            self.start()


def losses(service: Service, season: str, count: int) -> tuple[dict[str, int], list[str]]:
    """Return how many submissions ended how, and everything that was lost or counted twice."""
    rows = service.queries.submissions(limit=1000)
    lost = [] if len(rows) == count else [f"{len(rows)} submissions of {count}"]
    with service.database.read() as connection:
        results = Counter(connection.execute(sa.select(RESULT.submission)).scalars())
        query = sa.select(JOB.submission).where(JOB.failures >= jobs.MAX_FAILURES)
        struck = set(connection.execute(query).scalars())
    entries = service.queries.ledger()
    kinds = Counter((entry.kind, entry.body.get("id")) for entry in entries)
    try:
        check_chain(entries)
    except ValueError as error:
        lost.append(str(error))
    for row in rows:
        by_design = row.reason == "worker_errors" and row.id in struck
        if row.state not in FINAL_STATES or (row.state == "failed" and not by_design):
            lost.append(f"{row.id} is {row.state} for {row.reason}")
        if row.attempt != ("spent" if row.state == "scored" else "refunded"):
            lost.append(f"{row.id} is {row.state} and its attempt is {row.attempt}")
        if row.state == "scored" and results[row.id] != JOBS:
            lost.append(f"{row.id} has {results[row.id]} results")
        moments = kinds["submission", row.id], kinds["end", row.id], kinds["score", row.id]
        if moments != (1, 1, int(row.state == "scored")):
            lost.append(f"{row.id} is told {moments} times in the ledger")
    lost += wrong_scores(service)
    held = [row for row in service.queries.attempts(season) if row.reserved]
    lost += [f"{row.submitter} has {row.reserved} attempts reserved" for row in held]
    return dict(Counter(row.state for row in rows)), lost


def wrong_scores(service: Service) -> list[str]:
    """Return the scores on the public panel that are not what undisturbed work gives."""
    wrong = []
    with service.database.read() as connection:
        query = sa.select(schema.scores, SUBMISSION.artefact).join(
            schema.submissions, SUBMISSION.id == SCORE.submission
        )
        rows = connection.execute(query.where(SCORE.panel == "public")).all()
    for row in rows:
        strength = float(service.artefacts.get(row.artefact).decode().split()[1])
        mean = row.figures["mean"]
        if abs(mean - strength - public_ease()) > 1e-4:
            wrong.append(f"{row.submission} has {mean} for strength {strength}")
    return wrong


@functools.cache
def public_ease() -> float:
    """Return what the public panel adds to a robot's strength."""
    episodes = range(panel_episodes("scratch", "public"))
    names = FakeCatalogue().public_panel("scratch")
    return statistics.mean(noise(f"{PUBLIC_SEED:x}", name, k) for name in names for k in episodes)


@pytest.fixture(params=["sqlite", "postgres"])
def database(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, Cluster | None]:
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'service.db'}", None
    cluster = request.getfixturevalue("mortal_postgres")
    return cluster.url.render_as_string(hide_password=False), cluster


@pytest.mark.slow
def test_kills_of_processes_lose_nothing(
    database: tuple[str, Cluster | None], tmp_path: Path
) -> None:
    """ASSISTAX_KILLS=100 is the whole count, with 50 submissions."""
    url, cluster = database
    kills = int(os.environ.get("ASSISTAX_KILLS", "10"))
    count = max(5, kills // 2)
    service = real_service(tmp_path, url)
    season = open_season(service, budget=count)
    port = port_of_its_own()
    address = f"http://127.0.0.1:{port}"
    work = service.create_token(("work",))
    labs = [service.create_token(("submit",), submitter=f"lab {n}") for n in range(LABS)]
    server = Process("serve", tmp_path, url, port)
    workers = [Process("work", address, work) for _ in range(WORKERS)]
    struck: Counter[str] = Counter()
    threads = [
        threading.Thread(
            target=submit_and_wait,
            args=(address, labs[n % LABS], n, lambda n=n: struck.total() * count >= n * kills),
            daemon=True,
        )
        for n in range(count)
    ]
    began = time.monotonic()
    with contextlib.ExitStack() as stack:
        for process in (server, *workers):
            stack.callback(process.kill)
        for thread in threads:
            thread.start()
        rng = random.Random(f"kills {kills}")
        names = ["server", "worker", "database"] if cluster else ["server", "worker"]
        for _ in range(kills):
            name = rng.choice(names)
            time.sleep(rng.uniform(0.0, 2.0))
            strike(name, rng, server, workers, cluster)
            struck[name] += 1
        while any(thread.is_alive() for thread in threads):
            for process in (server, *workers):
                process.look()
            time.sleep(0.2)
            assert time.monotonic() - began < 60 + 30 * kills, "something never ends"
    states, lost = losses(service, season, count)
    service.database.close()
    line = {"database": url.partition(":")[0], "kills": dict(struck), "states": states}
    print(json.dumps({**line, "lost": lost, "seconds": round(time.monotonic() - began)}))
    assert lost == []
    assert states.get("scored", 0) > count // 2


def strike(
    name: str, rng: random.Random, server: Process, workers: list[Process], cluster: Any
) -> None:
    """Kill one of the processes, and start it again."""
    for process in (server, *workers):
        process.look()
    if name == "database":
        cluster.kill()
        time.sleep(rng.uniform(0.0, 1.0))
        cluster.start()
        return
    process = server if name == "server" else rng.choice(workers)
    process.kill()
    process.start()


def submit_and_wait(address: str, token: str, number: int, may_begin: Callable[[], bool]) -> None:
    """Hand a robot in, every seventh a broken one, and wait for its end as a submitter would."""
    while not may_begin():
        time.sleep(0.05)
    client = Client(address, token, patience=PATIENCE)
    data = b"broken" if number % 7 == 3 else f"robot {number}".encode()
    fields = {"task": "scratch", "method": "mine", "season": "spring"}
    id = client.submit(data, request_id=f"request-{number}", **fields)["id"]
    while client.submission(id)["state"] not in FINAL_STATES:
        time.sleep(3.0)
    client.close()


def ended(folder: Path) -> tuple[Service, str]:
    """Return a service with one scored submission and one that failed by design."""
    service = new_service(folder)
    season, lab = open_season(service), new_submitter(service)
    scored(service, lab, 2.0, "r1", season=season)
    service.submit(lab, draft(3.0, "r2", season=season))
    fail_next_job(service)
    return service, season


def test_a_failure_by_design_is_no_loss(tmp_path: Path) -> None:
    service, season = ended(tmp_path)
    assert losses(service, season, 2) == ({"scored": 1, "failed": 1}, [])


S = sa.update(schema.submissions)
PLANTED: dict[str, tuple[Any, str]] = {
    "one never ends": (S.where(SUBMISSION.state == "scored").values(state="running"), "is running"),
    "one fails though no job was struck at all its tries": (
        sa.update(schema.jobs).values(failures=1),
        "is failed for worker_errors",
    ),
    "the ledger lacks one": (sa.delete(schema.ledger).where(ENTRY.seq == 2), "does not follow"),
    "an attempt is lost": (
        S.where(SUBMISSION.state == "failed").values(attempt="spent"),
        "its attempt is spent",
    ),
    "an attempt stays reserved": (
        S.where(SUBMISSION.state == "failed").values(attempt="reserved"),
        "1 attempts reserved",
    ),
    "a result is missing": (sa.delete(schema.results).where(RESULT.panel == "A"), "3 results"),
    "a result is counted twice": (
        sa.update(schema.scores).where(SCORE.panel == "public").values(figures={"mean": 2.9}),
        "has 2.9",
    ),
}


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_loss_is_found(tmp_path: Path, name: str) -> None:
    service, season = ended(tmp_path)
    statement, message = PLANTED[name]
    with service.database.write() as connection:
        connection.execute(statement)
    assert any(message in row for row in losses(service, season, 2)[1])
