"""Clients that are slow or silent, a disk that is full, a server that is away for a while."""

import asyncio
import contextlib
import gc
import logging
import math
import socket
import threading
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from sqlalchemy import event
from starlette.requests import Request

from assistax_board import serve
from assistax_board.api import guards, operations
from assistax_board.rules import jobs
from assistax_board.service import Service
from assistax_board.store.notices import list_notices
from assistax_board.work.worker import Worker
from tests.board.fakes import TASK, FakeScorer, draft, new_service, new_submitter, work_off
from tests.board.running import Served, served, soon

HALF = b"GET /api/health HTTP/1.1\r\nHost: x\r\n"
SLOW = b"POST /api/submissions?task=scratch&method=m&request_id=12345678 HTTP/1.1\r\nHost: x\r\n"
SLOW += b"Content-Length: 1000\r\nAuthorization: Bearer %s\r\n\r\n"
FORM = b"POST /submit HTTP/1.1\r\nHost: x\r\nConnection: close\r\nCookie: assistax_form=x\r\n"
FORM += b"Content-Type: multipart/form-data; boundary=x\r\nX-Forwarded-For: %s\r\n"
FORM += b"Content-Length: %d\r\n\r\n"
SOON = 20.0


def connected(server: Served, data: bytes = b"") -> socket.socket:
    host, port = server.address.removeprefix("http://").split(":")
    connection = socket.create_connection((host, int(port)), timeout=SOON)
    connection.sendall(data)
    return connection


def hung_up(connection: socket.socket, before: float = math.inf) -> bool:
    """Return whether the server ends a connection, before it has sent so many bytes."""
    seen = 0
    with connection, contextlib.suppress(ConnectionError):
        try:
            while data := connection.recv(65536):
                seen += len(data)
        except TimeoutError:
            return False
    return seen < before


@pytest.mark.parametrize("data", [b"", HALF, HALF + b"\r\n" + HALF], ids=["none", "half", "next"])
def test_who_says_nothing_is_hung_up_on(
    service: Service, monkeypatch: pytest.MonkeyPatch, data: bytes
) -> None:
    monkeypatch.setattr(serve, "SILENT_SECONDS", 0.3)
    with served(service) as server:
        silent = [connected(server, data) for _ in range(50)]
        # Asked again where this machine took longer than that to send the question.
        assert server.client("submit").about()["tasks"] == [TASK]
        assert all(map(hung_up, silent))


@pytest.mark.slow
def test_without_that_they_would_stay(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    # The limit is taken away: nothing public can.
    monkeypatch.setattr(serve._IdleTimeout, "_look", lambda *_: None)
    with served(service) as server:
        silent = connected(server)
        silent.settimeout(2.0)
        assert not hung_up(silent)


@pytest.mark.parametrize("loop", ["asyncio", "auto"])
def test_crowd_is_accepted_in_small_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, loop: Any
) -> None:
    """However many wait, a turn of the event loop takes some of them and leaves the others."""
    monkeypatch.setattr(serve, "stop_limited", lambda: None)  # it would be for good
    taken, loops, over = [0], [], threading.Event()
    made = serve._IdleTimeout.connection_made  # private: nothing public knows of connections

    def connection_made(self: Any, transport: Any) -> None:
        loops.append(self.loop)
        taken[-1] += 1
        made(self, transport)

    def turn() -> None:
        taken.append(0)
        if not over.is_set():
            loops[0].call_soon(turn)

    def kind(config: Any) -> Any:
        config.loop = loop
        return serve._Server(config, lambda: None)  # private: what `serve` runs

    monkeypatch.setattr(serve._IdleTimeout, "connection_made", connection_made)
    with served(new_service(tmp_path), kind=kind) as server:
        assert httpx2.get(f"{server.address}/api/health").status_code == 200
        loops[0].call_soon_threadsafe(time.sleep, 1.0)  # the system lets the crowd wait meanwhile
        loops[0].call_soon_threadsafe(turn)
        crowd = [connected(server, HALF + b"Connection: close\r\n\r\n") for _ in range(300)]
        answers = [connection.recv(12) for connection in crowd]
        assert all(map(hung_up, crowd)) and set(answers) == {b"HTTP/1.1 200"}
        over.set()
    gc.unfreeze()
    assert 1 < max(taken) <= serve.LISTENERS * serve.TAKEN


def test_a_body_that_is_cut_off_is_no_error_of_the_service(
    service: Service, caplog: pytest.LogCaptureFixture
) -> None:
    token = service.create_token(("submit",), submitter="lab")
    with served(service) as server, caplog.at_level(logging.INFO):
        connected(server, SLOW % token.encode() + b"half of it").close()
        assert soon(lambda: "/api/submissions" in repr([vars(r) for r in caplog.records]))
        [seen] = [vars(r)["fields"] for r in caplog.records if "fields" in vars(r)]
        assert (seen["route"], seen["status"]) == ("/api/submissions", 408)
        assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
    assert list_notices(service.database) == [], "the organiser hears nothing of it"


class Counted:
    """A database that counts questions, and has an error if it is given one."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error, self.asked = error, 0

    @contextlib.contextmanager
    def read(self) -> Generator[Any]:
        self.asked += 1
        time.sleep(0.05)
        if self.error is not None:
            raise self.error
        yield self

    def execute(self, query: Any) -> None:
        pass


def test_a_crowd_that_asks_for_health_is_one_question(monkeypatch: pytest.MonkeyPatch) -> None:
    async def crowd(pulse: operations.Pulse, database: Any) -> list[Any]:
        asked = [pulse.feel(database) for _ in range(1000)]
        return await asyncio.gather(*asked, return_exceptions=True)

    async def twice() -> None:
        pulse, database = operations.Pulse(), Counted()
        for fresh, asked in ((100.0, 1), (100.0, 1), (0.0, 2)):
            monkeypatch.setattr(operations, "FRESH", fresh)
            assert await crowd(pulse, database) == [None] * 1000
            assert database.asked == asked
        away = Counted(OSError("away"))
        assert set(map(type, await crowd(pulse, away))) == {OSError}, "everybody hears of it"
        assert await crowd(pulse, database) == [None] * 1000, "and that it is back"

    asyncio.run(twice())


@pytest.mark.slow
def test_slow_body_is_cut_off(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(guards.BodyLimit.__init__, "__kwdefaults__", {"most": 2000, "seconds": 0.5})
    service = new_service(tmp_path)
    token = service.create_token(("submit",), submitter="lab")
    with served(service) as server:
        slow = connected(server, SLOW % token.encode())
        ended = threading.Thread(target=hung_up, args=(slow,))
        ended.start()
        assert httpx2.get(f"{server.address}/api/health").status_code == 200
        for _ in range(200):  # it goes on saying something, until it was hung up on
            with contextlib.suppress(OSError):
                slow.sendall(b"x")
            ended.join(0.1)
        assert not ended.is_alive()
    assert service.queries.submissions() == []


@pytest.mark.slow
def test_slow_forms_do_not_block_other_addresses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(guards, "FORM_SECONDS", 5.0)
    with served(new_service(tmp_path), proxy="127.0.0.1") as server:

        def begun(client: str, length: int) -> socket.socket:
            return connected(server, FORM % (client.encode(), length))

        def answer(client: str) -> int:
            with begun(client, 0) as connection:
                return int(connection.recv(65536).split()[1])

        slow = [begun("192.0.2.1", 1000) for _ in range(8)]
        began = time.monotonic()
        assert soon(lambda: answer("192.0.2.1") == 503)
        assert answer("192.0.2.2") == 403
        assert all(map(hung_up, slow)) and time.monotonic() - began < SOON
        assert answer("192.0.2.1") == 403  # no form of ours, and read


@pytest.mark.slow
def test_who_takes_no_answer_is_hung_up_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It asks for much, again and again, and reads nothing: no buffer of the system holds that."""
    monkeypatch.setattr(serve, "SILENT_SECONDS", 0.1)
    monkeypatch.setattr(serve, "TAKING_LOOKS", 5)
    service = new_service(tmp_path)
    service.artefacts.put(large := bytes(8 * 1024 * 1024))
    token = service.create_token(("work",))
    name = service.artefacts.put(large)
    ask = f"GET /api/work/artefacts/{name} HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {token}\r\n"
    with served(service) as server:
        taker = connected(server, f"{ask}\r\n".encode())
        time.sleep(5.0)
        assert hung_up(taker, before=len(large))


def test_an_upgrade_is_answered_as_a_plain_request(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """uvicorn would log two lines for each, and advise to install WebSockets."""
    upgrade, log = HALF + b"Connection: Upgrade\r\nUpgrade: websocket\r\n\r\n", "uvicorn.error"
    with served(new_service(tmp_path)) as server:
        caplog.set_level("WARNING", log)
        logging.getLogger(log).addHandler(caplog.handler)
        connection = connected(server, upgrade)
        assert b" 200 " in connection.recv(65536)
        connection.close()
        logging.getLogger(log).removeHandler(caplog.handler)
    assert caplog.messages == []


@pytest.mark.parametrize("length", [0, 5, 40])
def test_two_lengths_are_one_bad_request(service: Service, length: int) -> None:
    """A proxy that believes the other length would take the rest for a second request."""
    both = f"Content-Length: {length}\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n".encode()
    with served(service) as server, connected(server, HALF + both + HALF + b"\r\n") as connection:
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert answer.count(b"HTTP/1.1 ") == 1 and answer.startswith(b"HTTP/1.1 400 ")
    assert b"not both" in answer


def test_full_database_refuses_without_loss(service: Service) -> None:
    space = {"pages": 0}

    @event.listens_for(service.database.engine, "checkout")
    def bound(connection: Any, *_: Any) -> None:
        connection.execute(f"PRAGMA max_page_count={space['pages'] or 1_000_000}")

    with served(service) as server:
        client = server.client("submit", patience=0.0)
        with service.database.read() as connection:
            space["pages"] = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        taken, fields = [], {"task": TASK, "method": "m" * 80}
        with pytest.raises(OSError, match="503"):
            for number in range(1000):
                request = f"request-{number}"
                taken.append(client.submit(b"robot 1.0", request_id=request, **fields)["id"])
        assert len(service.queries.submissions(limit=1000)) == len(taken)
        space["pages"] = 0
        service.database.close()
        taken.append(client.submit(b"robot 1.0", request_id=request, **fields)["id"])
    work_off(service)
    states = {row.id: row.state for row in service.queries.submissions(limit=1000)}
    assert states == dict.fromkeys(taken, "scored")


@pytest.mark.parametrize("refused", [2, 3 * jobs.MAX_FAILURES])
def test_full_disk_at_result_loses_no_score(
    service: Service, monkeypatch: pytest.MonkeyPatch, refused: int
) -> None:
    """The worker is told so, and brings the result again when there is space."""
    service.submit(new_submitter(service), draft())
    real, left = service.artefacts.put, [refused]

    def put(data: bytes) -> str:
        if left[0]:
            left[0] -= 1
            monkeypatch.setattr("assistax_board.store.artefacts.atomic_write", full)
        else:
            monkeypatch.undo()
        return real(data)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with served(service) as server:
        working = server.client("work")
        object.__setattr__(service.artefacts, "put", put)
        Worker(working, FakeScorer(), idle=0.05, beat=1.0).run(until_empty=True)
    assert [row.state for row in service.queries.submissions()] == ["scored"]


@pytest.mark.usefixtures("one_window")
@pytest.mark.slow_for("60")
@pytest.mark.parametrize(("proxy", "answered"), [(None, 30), ("127.0.0.1", 60)])
def test_only_a_named_proxy_is_believed(service: Service, proxy: str | None, answered: int) -> None:
    """Guesses are limited by address, so nobody may choose an address with each guess."""
    with served(service, proxy=proxy) as server:
        address = f"{server.address}/api/work/artefacts/{'0' * 64}"
        guesses = [{"X-Forwarded-For": f"203.0.113.{number}"} for number in range(60)]
        codes = [httpx2.get(address, headers=headers).status_code for headers in guesses]
    assert codes.count(401) == answered
    assert set(codes) <= {401, 429}


@pytest.mark.parametrize(
    ("first", "second", "are_one"),
    [
        ("2001:db8::1", "2001:db8::ffff:ffff:ffff:ffff", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("fe80::1%eth0", "fe80::2", True),
        ("::ffff:203.0.113.1", "203.0.113.1", True),
        ("::ffff:203.0.113.1", "::ffff:203.0.113.2", False),
        ("203.0.113.1", "203.0.113.2", False),
        ("testclient", "unknown", False),
    ],
)
def test_rates_count_clients_and_ipv6_networks(first: str, second: str, are_one: bool) -> None:
    """Whoever has one address of IPv6 has 2 to the power of 64, and may take another each time."""
    names = [
        guards.client_of(Request({"type": "http", "headers": [], "client": (host, 1)}))
        for host in (first, second)
    ]
    assert (names[0] == names[1]) == are_one


@pytest.mark.parametrize("proxy", ["*", "caddy", "0.0.0.0/0", "", "127.0.0.1,*"])
def test_who_is_believed_is_an_address(proxy: str) -> None:
    with pytest.raises(ValueError, match="give its address"):
        guards.check_proxy(proxy)
    for address in (None, "127.0.0.1", "10.0.0.0/24, ::1"):
        guards.check_proxy(address)
