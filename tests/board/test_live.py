"""Live robots: the same score as at home, whatever happens to the connection."""

import asyncio
import contextlib
import threading
import time
from pathlib import Path
from socket import SHUT_RDWR, create_connection
from typing import Any

import msgpack
import numpy as np
import pytest
from limits import parse
from websockets.exceptions import ConnectionClosed, InvalidStatus

from assistax_board.api import guards
from assistax_board.client import Client
from assistax_board.live import client as live_client
from assistax_board.live import seats
from assistax_board.live.messages import decode, encode, pack_rows, unpack_rows
from assistax_board.live.robot import LiveRobot
from assistax_board.live.rooms import WAITING, BankEmpty, Rooms
from assistax_board.live.seats import Asked, Seats
from assistax_board.problems import Problem
from assistax_board.rules.tokens import Principal, list_tokens, revoke_token
from assistax_board.service import Service
from assistax_board.store.notices import list_notices
from assistax_board.work.worker import Worker
from tests.board.fakes import (
    TASK,
    FakeScorer,
    advance,
    draft,
    new_service,
    new_submitter,
    shown,
    take,
)
from tests.board.running import served
from tests.board.test_season import open_season

FIELDS = {"task": TASK, "method": "live", "kind": "live"}
SOON = 60.0  # seconds, also where many others use the machine


class Counting:
    """A robot with memory: its action is the number of steps it has seen since its reset."""

    def reset(self, rows: int) -> None:
        self.seen = 0

    def __call__(self, obs: np.ndarray) -> np.ndarray:
        self.seen += 1
        return np.full((len(obs), 3), self.seen, np.float32)


class Dropping:
    """A connection that is lost at every few messages, before or after sending."""

    def __init__(self, socket: Any, rng: np.random.Generator) -> None:
        self._socket, self._rng = socket, rng

    def __enter__(self) -> "Dropping":
        self._socket.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._socket.__exit__(*error)

    def recv(self) -> bytes:
        return self._socket.recv()

    def send(self, data: bytes) -> None:
        moment = self._rng.integers(6)
        if moment == 0:
            raise ConnectionError("lost before it was sent")
        self._socket.send(data)
        if moment == 1:
            raise ConnectionError("lost after it was sent")


def play(service: Service, robot: Any, connect: Any = None, workers: int = 1, **fields: Any) -> str:
    """Submit and play a live robot; return the submission's id."""
    with served(service) as server:
        submitter, working = server.client("submit"), server.client("work")
        fields = {"request_id": "request-1", **FIELDS, **fields}
        id = submitter.submit(b"", **fields)["id"]
        live = lambda work: LiveRobot(working, work)  # noqa: E731
        those = [
            Worker(working, FakeScorer(), live=live, idle=0.05, beat=1.0) for _ in range(workers)
        ]
        threads = [threading.Thread(target=worker.run) for worker in those]
        for thread in threads:
            thread.start()
        try:
            live_client.play_live(submitter, id, robot, connect=connect)
        finally:
            for worker, thread in zip(those, threads, strict=True):
                worker.stop()
                thread.join()
    return id


def test_a_live_robot_is_scored(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    id = play(service, Counting())
    assert shown(service, id).state == "scored"
    [score] = service.queries.scores(submission=id)
    assert 3.5 < score.figures["mean"] < 4.5  # the mean of 1 to 6, and the partners' own part


@pytest.mark.slow
def test_lost_connections_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_client, "PAUSE_SECONDS", 0.01)
    rng = np.random.default_rng(0)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    calm, stormy = new_service(tmp_path / "a"), new_service(tmp_path / "b")
    first = play(calm, Counting())

    def connect(client: Client, submission: str) -> Dropping:
        # A real connection, that the test lets drop.
        return Dropping(live_client._connect(client, submission), rng)

    second = play(stormy, Counting(), connect)
    means = [
        service.queries.scores(submission=id)[0].figures["mean"]
        for service, id in ((calm, first), (stormy, second))
    ]
    assert means[0] == means[1]


def test_numbers_that_are_not_finite_end_it_with_a_word(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    id = play(service, lambda obs: np.full((len(obs), 3), np.nan, np.float32))
    assert (shown(service, id).state, shown(service, id).reason) == ("refused", "not_finite")


@pytest.mark.parametrize("width", [1, 2, 300])
def test_an_action_of_another_width_ends_it_with_a_word(tmp_path: Path, width: int) -> None:
    service = new_service(tmp_path)
    id = play(service, lambda obs: np.zeros((len(obs), width), np.float32))
    assert (shown(service, id).state, shown(service, id).reason) == ("refused", "wrong_sizes")
    assert list_notices(service.database) == []


def test_live_robots_never_meet_hidden_partners(tmp_path: Path) -> None:
    """Their observations leave the server, a whole panel's in one batch."""
    service = new_service(tmp_path)
    season = open_season(service)
    with served(service) as server:
        owner = server.client("submit")
        with pytest.raises(Problem, match="public partners alone"):
            owner.submit(b"", request_id="request-1", season=season, **FIELDS)
    assert service.queries.submissions() == []


def test_a_revoked_token_ends_its_live_connection(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    with served(service) as server:
        owner = server.client("submit")
        [token] = list_tokens(service.database)
        with contextlib.closing(websocket(owner, id := handed_in(owner))) as socket:
            server.client("submit")  # another token of the lab, which stays valid
            revoke_token(service.database, service.clock(), token.id)
            with pytest.raises(ConnectionClosed):
                socket.recv(SOON)
    assert shown(service, id).state == "queued"


def test_nobody_plays_for_another(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    with served(service) as server:
        owner = server.client("submit")
        id = owner.submit(b"", request_id="request-1", **FIELDS)["id"]
        other = server.client("submit", "another lab")
        with pytest.raises(ValueError, match="no live submission"):
            live_client.play_live(other, id, Counting())


def test_who_comes_back_late_is_told_how_it_ended(tmp_path: Path) -> None:
    """The connection may be lost while the last answer is being scored."""
    service = new_service(tmp_path)
    id = play(service, Counting())
    with served(service) as server:
        assert live_client.play_live(server.client("submit"), id, Counting()) == "scored"


def test_jobs_wait_for_the_client(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    with served(service) as server:
        owner, working = server.client("submit"), server.client("work")
        owner.submit(b"", request_id="request-1", **FIELDS)
        assert working.lease("w", FakeScorer().versions()) is None


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        "text",
        msgpack.packb({"type": "act"}),
        msgpack.packb({"type": "act", "batch": "b", "step": "0", "rows": 1, "numbers": b""}),
        msgpack.packb({"type": "act", "batch": "b", "step": True, "rows": 1, "numbers": b""}),
        msgpack.packb(msgpack.ExtType(1, b"code")),
        msgpack.packb({"type": "observe", "batch": "b", "step": 0, "rows": 1, "numbers": b""}),
        bytes(5 * 1024 * 1024),
    ],
)
def test_what_is_no_message_is_refused(data: Any) -> None:
    with pytest.raises(ValueError):
        decode(data, "act")


def test_messages_are_what_was_sent() -> None:
    rows = np.random.default_rng(0).normal(size=(5, 3)).astype(np.float32)
    message = decode(encode("act", batch="b", step=3, **pack_rows(rows)), "act")
    np.testing.assert_array_equal(unpack_rows(message), rows)
    for wrong in ({"rows": 4}, {"rows": 0}, {"numbers": b""}, {"rows": 10**9}):
        with pytest.raises(ValueError, match="bytes are not"):
            unpack_rows({**message, **wrong})


def websocket(client: Client, id: str) -> Any:
    """Return an open connection to a live submission's room."""
    return live_client._connect(client, id).__enter__()


def handed_in(client: Client, number: int = 1) -> str:
    return client.submit(b"", request_id=f"request-{number}", **FIELDS)["id"]


def is_present(working: Client) -> bool:
    """Return whether a client is there, by whether its job is given out."""
    work = working.lease("w", FakeScorer().versions())
    if work is not None:
        working.give_back(work)
    return work is not None


def soon(condition: Any, seconds: float = SOON) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


@pytest.mark.parametrize("gently", [True, False])
def test_who_leaves_while_no_question_waits_is_missed(tmp_path: Path, gently: bool) -> None:
    with served(new_service(tmp_path)) as server:
        owner, working = server.client("submit"), server.client("work")
        socket = websocket(owner, handed_in(owner))
        assert soon(lambda: is_present(working))
        if gently:
            socket.close()
        else:
            socket.socket.shutdown(SHUT_RDWR)
        assert soon(lambda: not is_present(working))


def test_one_token_cannot_take_all_connections(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(seats, "SEATS_OF_OWNER", 3)
    with served(new_service(tmp_path)) as server:
        owner = server.client("submit")
        names = [handed_in(owner, number) for number in range(4)]
        sockets = [websocket(owner, name) for name in names[:3]]
        with pytest.raises(InvalidStatus) as refused:
            websocket(owner, names[3])
        assert refused.value.response.status_code == 429
        sockets[0].close()
        assert soon(lambda: connects(owner, names[3]))
        for socket in sockets:
            socket.close()


def connects(client: Client, id: str) -> bool:
    with contextlib.suppress(InvalidStatus):
        websocket(client, id).close()
        return True
    return False


def test_a_submission_has_one_connection_the_newest(tmp_path: Path) -> None:
    with served(new_service(tmp_path)) as server:
        owner, working = server.client("submit"), server.client("work")
        id = handed_in(owner)
        first = websocket(owner, id)
        with contextlib.closing(websocket(owner, id)):
            with pytest.raises(ConnectionClosed):
                first.recv(SOON)
            assert is_present(working)


@pytest.mark.usefixtures("one_window")
def test_connections_that_are_opened_all_the_time_are_limited(tmp_path: Path) -> None:
    with served(new_service(tmp_path)) as server:
        owner = server.client("submit")
        id = handed_in(owner)
        opened = [connects(owner, id) for _ in range(130)]
        assert opened[:100] == [True] * 100 and not any(opened[120:])
        assert owner.about()["tasks"] == [TASK]


@pytest.mark.parametrize("data", ["text", b"\xc1"])
def test_what_nobody_asked_for_ends_the_connection_alone(tmp_path: Path, data: Any) -> None:
    service = new_service(tmp_path)
    with served(service) as server:
        owner = server.client("submit")
        with contextlib.closing(websocket(owner, id := handed_in(owner))) as socket:
            socket.send(data)
            with pytest.raises(ConnectionClosed) as closed:
                socket.recv(SOON)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1008
    assert shown(service, id).state == "queued"


def test_a_text_instead_of_an_answer_is_refused(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    with served(service) as server:
        owner, working = server.client("submit"), server.client("work")
        with contextlib.closing(websocket(owner, id := handed_in(owner))) as socket:
            assert soon(lambda: is_present(working))
            work = working.lease("w", FakeScorer().versions())
            assert work is not None
            robot = LiveRobot(working, work)
            asking = threading.Thread(target=ask_once, args=(robot,))
            asking.start()
            socket.recv(SOON)
            socket.send("text")
            assert decode(socket.recv(SOON), "end")["state"] == "refused"
            asking.join()
    assert shown(service, id).reason == "malformed"


def ask_once(robot: LiveRobot) -> None:
    with contextlib.suppress(ValueError):
        robot(np.zeros((2, 4), np.float32))


def test_time_away_is_taken_from_the_bank(tmp_path: Path) -> None:
    """A client that is there for moments only, at one server or the other, thinks for ever else."""
    service = new_service(tmp_path)
    lab = Principal("token", ("submit",), new_submitter(service))
    id = service.submit(str(lab.submitter), draft(data=None, kind="live"))
    houses = [Rooms(places_of(service), bank=0.3) for _ in range(2)]

    async def flicker() -> None:
        seat = await houses[0].take_seat(id, lab, 3)
        work = take(service)
        asked = Asked(id, work.job, work.lease, ("run.1", 0), b"")
        asking = asyncio.create_task(houses[0].ask(asked, 5.0))
        for turn in range(1000):
            await houses[turn % 2].leave(seat)
            if asking.done():
                break
            await asyncio.sleep(0.05)
            seat = await houses[(turn + 1) % 2].take_seat(id, lab, 3)
        await asking

    with pytest.raises(BankEmpty):
        asyncio.run(asyncio.wait_for(flicker(), 20.0))


def test_a_crowd_at_the_door_is_sent_away(tmp_path: Path) -> None:
    rooms = Rooms(places_of(new_service(tmp_path)))

    async def come(leave: asyncio.Event) -> None:
        async with rooms.door():
            await leave.wait()

    async def crowd() -> list[Any]:
        leave = asyncio.Event()
        coming = [asyncio.create_task(come(leave)) for _ in range(WAITING + 3)]
        await asyncio.sleep(0.1)
        sent_away = [task.exception() for task in coming if task.done()]
        leave.set()
        await asyncio.gather(*coming, return_exceptions=True)
        await come(leave)  # there is room again
        return sent_away

    sent_away = asyncio.run(asyncio.wait_for(crowd(), 20.0))
    assert [problem.code for problem in sent_away] == 3 * ["too_many_requests"]


def test_a_crowd_that_knocks_in_one_turn_is_sent_away_before_connections_are_made(
    tmp_path: Path,
) -> None:
    rooms = Rooms(places_of(new_service(tmp_path)))

    async def crowd() -> list[int]:
        sent_away = []
        for _ in range(2):  # the second comes when the turn of the first is over
            sent_away.append(0)
            for _ in range(WAITING + 3):
                try:
                    rooms.knock()
                except Problem:
                    sent_away[-1] += 1
            await asyncio.sleep(0.0)
        return sent_away

    assert asyncio.run(crowd()) == [3, 3]


@pytest.mark.usefixtures("one_window")
def test_live_connections_are_counted_by_the_address_that_a_proxy_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """No connection is made of one that is refused, and its refusal is no error to log."""
    monkeypatch.setattr(guards, "READ", parse("2/minute"))
    made = []
    for proxy in (None, "127.0.0.1"):
        with served(new_service(tmp_path / str(proxy)), proxy=proxy) as server:
            host, port = server.address.removeprefix("http://").split(":")
            answers = []
            for number in range(6):
                with create_connection((host, int(port)), 10.0) as line:
                    line.sendall(UPGRADE % (b"10.0.0.%d" % (number % 3)))
                    answers.append(b"".join(iter(lambda: line.recv(4096), b"")))
            made.append([int(answer.split()[1]) for answer in answers])
            for answer in answers:
                assert b"Retry-After: " in answer.title() and b"Connection: Close" in answer.title()
    assert made == [[401, 401, 429, 429, 429, 429], [401] * 6]
    assert not caplog.records


UPGRADE = (
    b"GET /api/live/none HTTP/1.1\r\nHost: here\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    b"X-Forwarded-For: %b\r\n\r\n"
)


def places_of(service: Service) -> Seats:
    return Seats(service.database, service.clock)


def test_who_comes_and_goes_without_playing_is_gone_after_a_day(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    id = service.submit(new_submitter(service), draft(data=None, kind="live"))
    places = places_of(service)
    for _ in range(25):
        places.leave(id, places.take(id, "lab"), 0.0)
        service.lease("w", FakeScorer().versions(), places)
        assert shown(service, id).state == "queued"
        advance(service, 3600.0)
    places.leave(id, places.take(id, "lab"), 0.0)
    service.lease("w", FakeScorer().versions(), places)
    assert (shown(service, id).state, shown(service, id).reason) == ("failed", "client_gone")


def test_a_client_has_time_to_come_however_long_the_server_runs(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    places, versions = places_of(service), FakeScorer().versions()
    advance(service, 2 * seats.GONE_SECONDS)
    id = service.submit(new_submitter(service), draft(data=None, kind="live"))
    service.lease("w", versions, places)
    assert shown(service, id).state == "queued"
    advance(service, 2 * seats.GONE_SECONDS)
    service.lease("w", versions, places_of(service))  # of a server that has only just begun
    assert shown(service, id).state == "queued"
    service.lease("w", versions, places)
    assert shown(service, id).reason == "client_gone"


def test_a_live_robot_plays_one_job_after_another(tmp_path: Path) -> None:
    """Two workers that asked it in turns would each get what it answered to the other."""
    service = new_service(tmp_path)
    id = service.submit(new_submitter(service), draft(data=None, kind="live"))
    places_of(service).take(id, "lab")
    work = take(service)
    assert service.lease("another", FakeScorer().versions()) is None
    service.give_back(work.job, work.lease)
    assert take(service).submission == id


def test_an_upgrade_lets_a_live_robot_begin_anew(tmp_path: Path) -> None:
    """What was played before is of another version, and no worker of that one comes any more."""
    service = new_service(tmp_path)
    id = service.submit(new_submitter(service), draft(data=None, kind="live"))
    places_of(service).take(id, "lab")
    work = take(service)
    service.give_back(work.job, work.lease)
    upgraded = new_service(tmp_path, version=2)
    assert upgraded.adopt_version() == 1
    work = take(upgraded, version=2)
    assert (work.submission, work.chunk) == (id, 0)
    assert upgraded.adopt_version() == 0


@pytest.mark.slow
def test_several_workers_do_not_show(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    alone, several = new_service(tmp_path / "a"), new_service(tmp_path / "b")
    ids = play(alone, Counting()), play(several, Counting(), workers=3)
    scores = [
        service.queries.scores(submission=id)[0].figures["mean"]
        for service, id in zip((alone, several), ids, strict=True)
    ]
    assert scores[0] == scores[1]
