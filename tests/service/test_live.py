"""Live robots: the same score as at home, whatever happens to the connection."""

import threading
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from assistax_zoo.service.client import Client
from assistax_zoo.service.live import client as live_client
from assistax_zoo.service.live.messages import decode, encode, pack_rows, unpack_rows
from assistax_zoo.service.live.robot import LiveRobot
from assistax_zoo.service.problems import Problem
from assistax_zoo.service.service import Service
from assistax_zoo.service.worker import Worker
from tests.service.fakes import TASK, FakeScorer, new_service, shown
from tests.service.running import served
from tests.service.test_season import open_season

FIELDS = {"task": TASK, "method": "live", "kind": "live"}


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


def play(service: Service, robot: Any, connect: Any = None, **fields: Any) -> str:
    """Submit and play a live robot with one worker; return the submission's id."""
    with served(service) as server:
        submitter, working = server.client("submit"), server.client("work")
        fields = {"request_id": "request-1", **FIELDS, **fields}
        id = submitter.submit(b"", **fields)["id"]
        live = lambda work: LiveRobot(working, work)  # noqa: E731
        worker = Worker(working, FakeScorer(), live=live, idle=0.05, beat=1.0)
        thread = threading.Thread(target=worker.run)
        thread.start()
        try:
            live_client.play_live(submitter, id, robot, connect=connect)
        finally:
            worker.stop()
            thread.join()
    return id


def test_a_live_robot_is_scored(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    id = play(service, Counting())
    assert shown(service, id).state == "scored"
    [score] = service.queries.scores(submission=id)
    assert 3.5 < score.figures["mean"] < 4.5  # the mean of 1 to 6, and the partners' own part


def test_lost_connections_do_not_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_client, "PAUSE_SECONDS", 0.01)
    rng = np.random.default_rng(0)
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    calm, stormy = new_service(tmp_path / "a"), new_service(tmp_path / "b")
    first = play(calm, Counting())

    def connect(client: Client, submission: str) -> Dropping:
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


def test_live_robots_never_meet_hidden_partners(tmp_path: Path) -> None:
    """Their observations leave the server, a whole panel's in one batch."""
    service = new_service(tmp_path)
    season = open_season(service)
    with served(service) as server:
        owner = server.client("submit")
        with pytest.raises(Problem, match="public partners alone"):
            owner.submit(b"", request_id="request-1", season=season, **FIELDS)
    assert service.queries.submissions() == []


def test_nobody_plays_for_another(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    with served(service) as server:
        owner = server.client("submit")
        id = owner.submit(b"", request_id="request-1", **FIELDS)["id"]
        other = server.client("submit", "another lab")
        with pytest.raises(ValueError, match="no live submission"):
            live_client.play_live(other, id, Counting())


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
