"""Hardships of a board while a season is open or closes, each done to the real server."""

import contextlib
import time
from collections.abc import Generator, Iterator
from threading import Event, Lock, Thread
from typing import Any

import sqlalchemy as sa

from assistax_board.client import Client
from assistax_board.ids import new_id
from assistax_board.problems import Problem
from assistax_board.rehearsal.disk import full_disk
from assistax_board.rehearsal.server import Server
from assistax_board.rehearsal.stage import LIMIT_SECONDS, SEASON, Stage, wait, watch
from assistax_board.rules.jobs import OPEN
from assistax_board.serve import only_server, open_service
from assistax_board.service import Service
from assistax_board.store.database import DATABASE_FILE
from assistax_board.store.migrations.moving import move_board
from assistax_board.store.schema import JOB

FULL_SECONDS = 10.0  # for which the disk is full


class Board:
    """The board of a rehearsal: its data, its server, its labs, and the season kept open."""

    def __init__(self, stage: Stage, service: Service, server: Server) -> None:
        self.stage, self.service, self.server = stage, service, server
        self.submitted: list[tuple[Client, str]] = []  # each with its lab's client
        self._clients = contextlib.ExitStack()
        self._moving, self._left = Lock(), Event()

    @classmethod
    @contextlib.contextmanager
    def opened(cls, stage: Stage, service: Service, server: Server) -> Generator["Board"]:
        """Make one, and let go of its clients and its season at the end."""
        board = cls(stage, service, server)
        try:
            yield board
        finally:
            board.leave()
            board._clients.close()

    def client(self, token: str | None = None) -> Client:
        """Return a client of its server."""
        made = Client(self.server.address, token, patience=LIMIT_SECONDS)
        return self._clients.enter_context(contextlib.closing(made))

    def state(self) -> str:
        """Return the season's state, as anybody reads it."""
        with contextlib.closing(Client(self.server.address, patience=LIMIT_SECONDS)) as client:
            return client.call("GET", f"/api/seasons/{SEASON}").json()["state"]

    def closing_date(self) -> float:
        """Return when the season closes, in seconds since 1970."""
        [season] = self.service.queries.seasons()
        return season.closes_at or 0.0

    def keep_open(self) -> None:
        """Extend the season again and again until `leave`, however busy this machine is."""
        Thread(target=self._extend, daemon=True).start()

    def leave(self) -> None:
        """Let the season come to its closing date."""
        self._left.set()

    @contextlib.contextmanager
    def moving(self) -> Generator[None]:
        """Touch the database with nothing else while the block runs."""
        with self._moving:
            if not self._left.is_set():
                self._extend_once()
            yield

    def _extend(self) -> None:
        while not self._left.wait(1.0):
            with self._moving, contextlib.suppress(Exception):  # of a full disk, for a while
                self._extend_once()

    def _extend_once(self) -> None:
        now = self.service.clock()
        if self.closing_date() < now + self.stage.open_seconds / 2:
            self.service.extend_season(SEASON, now + self.stage.open_seconds)

    def open_jobs(self) -> int:
        """Count the jobs of the newest version that are not done."""
        version = self.service.served(self.stage.task)
        with self.service.database.read() as connection:
            query = sa.select(sa.func.count()).where(JOB.version == version, JOB.state.in_(OPEN))
            return connection.execute(query).scalar_one()


def fill_disk(board: Board, is_small: bool) -> Iterator[str]:
    """Leave no byte on the board's disk for a while; whoever hands in meanwhile is told."""
    if not is_small:
        yield "left out: no file system of its own may be mounted here (it needs root)"
        return
    [client, _], *_ = board.submitted
    with full_disk(board.stage.data):
        yield f"the board's own disk of 64 MB is full, for {FULL_SECONDS:.0f} s"
        began = time.monotonic()
        with contextlib.closing(
            Client(board.server.address, client.token, patience=0.0)
        ) as impatient:
            fields: dict[str, Any] = {"task": board.stage.task, "method": "while it is full"}
            try:
                impatient.submit(bytes(100_000), request_id=new_id(20), **fields)
                answer = "took a file all the same: it found room"
            except (Problem, OSError) as problem:
                answer = f"answered: {problem}"
        yield f"whoever handed in a file of 100 kB then {answer}"
        board.client().call("GET", "/")
        time.sleep(max(0.0, FULL_SECONDS - (time.monotonic() - began)))
    yield "the disk has room again"


def upgrade(board: Board) -> Iterator[str]:
    """Start the server in the newest version once one robot was scored by the version before."""
    stage, (client, id) = board.stage, board.submitted[0]
    yield from watch(client, id)
    yield "stopping the server, and starting its newest version"
    board.server.stop()
    board.server.start(stage.backend)
    yield f"upgraded while the season is open: {stage.backend} plays anew what {stage.older} scored"


def roll_back(board: Board) -> Iterator[str]:
    """Go back to the version before, which still has its scores, and forward again.

    Raises:
        ValueError: Something is played twice, or a score is gone.
    """
    stage, (client, id) = board.stage, board.submitted[0]
    yield from wait("all robots are played anew", lambda: board.open_jobs() == 0)
    before, state = _table(board), client.submission(id)["state"]
    if state != "scored":
        raise ValueError(f"after the upgrade {id} is {state}")
    yield f"stopping the server, and starting the version before, on {stage.older}"
    board.server.stop()
    board.server.start(stage.older)
    if id not in _table(board):
        raise ValueError(f"after the rollback the board lacks {id}, which this version had scored")
    yield f"rolled back: the board shows {stage.older}'s own scores"
    yield f"stopping the server, and starting its newest version, on {stage.backend}"
    board.server.stop()
    board.server.start(stage.backend)
    if (now := _table(board)) != before:
        raise ValueError(f"forward again, the board differs: {now[:300]}, and was {before[:300]}")
    if again := board.open_jobs():
        raise ValueError(f"forward again, {again} jobs are played twice")
    yield "forward again: nothing is played twice, and the board is as before"


def _table(board: Board) -> str:
    """Return the public board as its CSV."""
    return board.client().call("GET", f"/tasks/{board.stage.task}.csv").text


def move(board: Board, to: str) -> Iterator[str]:
    """Move the board to another database, as `service move` does, and let its server go on there.

    A server that runs is stopped before and started after. To the folder's own database it moves
    back, in place of the file that was left there.
    """
    stage, server = board.stage, board.server
    runs = server.process.poll() is None
    with board.moving():
        if runs:
            yield "stopping the server, and copying all rows"
            server.stop()
        if to.endswith(DATABASE_FILE):
            for path in stage.data.glob(f"{DATABASE_FILE}*"):
                path.unlink()
        with only_server(stage.data):
            count = move_board(stage.data, board.service.database, to)
        board.service.database.close()
        board.service = open_service(stage.data, registry=stage.public, backend=stage.backend)
        kind = board.service.database.url.get_backend_name()
        yield f"moved {count} rows to {kind}, all compared"
        if runs:
            server.start(stage.backend)
            yield f"the server goes on, on {kind}"


def kill(board: Board) -> Iterator[str]:
    """Kill the server while the season closes; another version must not start in its place.

    Raises:
        ValueError: The season closed before its date, or the other version starts.
    """
    stage, server = board.stage, board.server
    board.leave()
    closes_at = board.closing_date()
    left = closes_at - board.service.clock()
    yield f"the season closes in {left:.0f} s"
    yield from wait("the season closes at its date", lambda: board.state() in ("closing", "closed"))
    server.kill()
    if board.service.clock() < closes_at:
        raise ValueError("the season closed before its date")
    yield "the closing date came: nothing more is taken, panel B is played"
    [season] = board.service.queries.seasons()
    if season.state != "closing":
        raise ValueError(f"the season is {season.state}; it was to be closing when the kill came")
    yield f"killed the server while the season closes; starting it on {stage.older} in vain"
    try:
        server.start(stage.older)
    except ValueError as error:
        if "is closing" not in str(error):
            raise
    else:
        raise ValueError("a server of another version started while the season closes")
    yield f"a server on {stage.older} does not start: the season closes by one version"
    server.start(stage.backend)
    yield f"the server goes on, on {stage.backend}"
