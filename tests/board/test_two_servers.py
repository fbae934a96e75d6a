"""Two servers behind one address, as processes with one database, are one service."""

import contextlib
import csv
import dataclasses
import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
import sqlalchemy as sa

from assistax_board.api.guards import FORM, SIGN_IN
from assistax_board.api.rates import SHARE_SECONDS
from assistax_board.client import Client
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.vocabulary import Scope
from assistax_board.work.worker import Worker
from tests.board.fakes import TASK, FakeScorer, draft, new_submitter, shown, work_off
from tests.board.faulty import LEASE_SECONDS, PATIENCE, real_service
from tests.board.running import port_of_its_own, soon
from tests.board.test_faults_processes import Process
from tests.board.test_postgres import at_once as together
from tests.board.test_season import open_season

pytestmark = pytest.mark.slow


class Either:
    """What a proxy does: every request goes to the next server that answers."""

    def __init__(self, servers: list[httpx2.Client]) -> None:
        self._servers = servers
        self._turn = 0

    def request(self, method: str, path: str, **options: Any) -> Any:
        for _ in self._servers:
            self._turn += 1
            number = self._turn % len(self._servers)
            with contextlib.suppress(httpx2.ConnectError):
                return self._servers[number].request(method, path, **options)
        raise httpx2.ConnectError("no server answers")


@dataclasses.dataclass
class Pair:
    """Two servers, and the service that both have."""

    service: Service
    addresses: list[str]
    processes: list[Process]
    stack: contextlib.ExitStack  # ends what a test opens

    def http(self, server: int) -> httpx2.Client:
        client = httpx2.Client(base_url=self.addresses[server], timeout=60.0)
        return self.stack.enter_context(client)

    def client(self, server: int, scope: Scope) -> Client:
        owner = "lab" if scope == "submit" else None
        token = self.service.create_token((scope,), submitter=owner)
        return Client("", token, transport=self.http(server), patience=PATIENCE)

    def worker(self) -> tuple[Worker, Either]:
        """Return a worker whose requests go to both in turns."""
        either = Either([self.http(server) for server in (0, 1)])
        client = Client("", self.service.create_token(("work",)), transport=either, patience=60.0)
        return Worker(client, FakeScorer(), idle=0.05, beat=LEASE_SECONDS / 4), either


@pytest.fixture(params=["sqlite", "postgres"])
def pair(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Pair]:
    url = f"sqlite:///{tmp_path / 'service.db'}"
    if request.param == "postgres":
        url = request.getfixturevalue("postgres_url")
    ports = [port_of_its_own() for _ in range(2)]
    with contextlib.ExitStack() as stack:
        processes = [Process("serve", tmp_path, url, port) for port in ports]  # it is empty yet
        for process in processes:
            stack.callback(process.kill)
        service = real_service(tmp_path, url)
        addresses = [f"http://127.0.0.1:{port}" for port in ports]
        both = Pair(service, addresses, processes, stack)
        for server in (0, 1):
            both.client(server, "work").about()
        yield both
    service.database.close()


def test_rates_hold_across_both(pair: Pair) -> None:
    def guess(server: int) -> int:
        headers = {"Authorization": "Bearer azt_guess"}
        return httpx2.get(f"{pair.addresses[server]}/api/limits", headers=headers).status_code

    # A window begins with each minute, and in the next one its guesses count less and less.
    if (second := time.time() % 60.0) > 25.0:
        time.sleep(60.0 - second)
    guesses = [guess(0) for _ in range(SIGN_IN.amount - 5)]
    time.sleep(6 * SHARE_SECONDS)
    guesses += [guess(1) for _ in range(10)]
    assert guesses == [401] * SIGN_IN.amount + [429] * 5
    time.sleep(6 * SHARE_SECONDS)
    assert guess(0) == 429
    with pair.service.database.read() as connection:
        assert "127.0.0.1" not in str(connection.execute(sa.select(schema.rates)).all())


def test_a_form_of_one_server_is_answered_by_the_other(pair: Pair) -> None:
    first, second = pair.http(0), pair.http(1)
    page = first.get("/submit")
    field = re.search(r'name="form_token" value="(\w+)"', page.text)
    assert field is not None and FORM.amount
    form = {"form_token": field[1], "account_token": "azt_wrong", "task": TASK}
    sent = {"Cookie": f"assistax_form={page.cookies['assistax_form']}"}
    answer = second.post("/submit", data=form, files={"file": b"robot 1"}, headers=sent)
    assert answer.status_code == 401  # the token is wrong; the form is right


def test_a_board_that_one_computed_is_shown_by_the_other(pair: Pair) -> None:
    pair.service.submit(new_submitter(pair.service), draft(1.0))
    work_off(pair.service)
    mean = shown_mean(pair, 0)
    assert mean < 10.0
    with pair.service.database.write() as connection:  # a figure that nobody would compute
        text = connection.execute(sa.select(schema.computed.c.value)).scalar_one()
        [(key, row)] = json.loads(text).items()
        row["m_test"]["mean"] = 4321.0
        changed = json.dumps({key: row})
        connection.execute(sa.update(schema.computed).values(value=changed))
    assert shown_mean(pair, 1) == 4321.0
    assert shown_mean(pair, 0) == mean


def shown_mean(pair: Pair, server: int) -> float:
    """Return M_test of the first row of a server's board, once it is there."""
    address, end = f"/tasks/{TASK}.csv", time.monotonic() + 60.0
    while time.monotonic() < end:
        text = pair.http(server).get(address).text
        rows = list(csv.DictReader(line for line in text.splitlines() if line[:1] != "#"))
        if rows and "m_test" in rows[0]:
            return float(rows[0]["m_test"])
        time.sleep(0.5)
    pytest.fail(f"no board: {text}")


def at_once(pair: Pair, scope: Scope, ask: Callable[[Client, int], Any], count: int) -> list[Any]:
    """Ask both servers in turns, in threads that start together; return answers and problems."""
    clients = [pair.client(number % 2, scope) for number in range(count)]
    return together(count, lambda number: ask(clients[number], number))


def held(service: Service) -> int:
    """Return how many jobs of hidden panels wait until the public one is done."""
    with service.database.read() as connection:
        query = sa.select(sa.func.count()).where(schema.jobs.c.state == "held")
        return connection.execute(query).scalar_one()


def test_what_comes_to_both_at_once_is_taken_once(pair: Pair) -> None:
    open_season(pair.service, budget=1)
    fields = {"task": TASK, "method": "mine"}

    def repeated(client: Client, _: int) -> str:
        return client.submit(b"robot 1.0", request_id="request-0", **fields)["id"]

    def last_attempt(client: Client, number: int) -> str:
        request = f"request-{number + 1}"
        return client.submit(b"robot 1.0", request_id=request, season="spring", **fields)["id"]

    assert len(set(at_once(pair, "submit", repeated, 8))) == 1
    assert at_once(pair, "submit", last_attempt, 8).count("budget_spent") == 7
    versions = FakeScorer().versions()
    works = at_once(pair, "work", lambda client, n: client.lease(f"w{n}", versions), 8)
    jobs = [work.job for work in works if work is not None]
    assert len(jobs) == len(set(jobs)) == 2 * 3 + 2 - held(pair.service)


def test_a_board_that_both_compute_at_once_is_one(pair: Pair) -> None:
    """Neither fails by the other's figures, and only the newest are kept."""
    lab, before = new_submitter(pair.service), 0.0
    for number in range(3):
        pair.service.submit(lab, draft(float(number + 1), f"r{number}", method=f"robot {number}"))
        work_off(pair.service)

        def is_shown(before: float = before) -> bool:
            means = set(together(6, lambda n: shown_mean(pair, n % 2)))
            return len(means) == 1 and means.pop() > before

        assert soon(is_shown, 120.0), "a page may be older for some seconds"
        before = shown_mean(pair, 0)
    with pair.service.database.read() as connection:
        assert len(connection.execute(sa.select(schema.computed)).all()) == 1


def test_two_workers_of_two_servers_lose_nothing(pair: Pair) -> None:
    lab = new_submitter(pair.service)
    ids = [pair.service.submit(lab, draft(float(n), f"r{n}")) for n in range(8)]
    workers = [pair.worker()[0] for _ in range(3)]
    threads = [
        threading.Thread(target=worker.run, kwargs={"until_empty": True}) for worker in workers
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {shown(pair.service, id).state for id in ids} == {"scored"}
    with pair.service.database.read() as connection:
        assert set(connection.execute(sa.select(schema.jobs.c.failures)).scalars()) == {0}
