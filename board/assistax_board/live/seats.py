"""Which connection a live submission has: a row of the database, that all servers read and write.

A connection lives in one server's process, a worker may ask at another. So the row also carries
the question that was asked elsewhere, and its answer back. What is asked at the server that has
the connection never comes here.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa

from assistax_board.clock import Clock
from assistax_board.ids import new_id
from assistax_board.live.messages import Step, is_newer
from assistax_board.problems import Problem
from assistax_board.rules.jobs import held_job
from assistax_board.store import schema
from assistax_board.store.database import Database, insert_once
from assistax_board.store.schema import SEAT, SUBMISSION, TOKEN
from assistax_board.vocabulary import FINAL_STATES

SEAT_SECONDS = 10.0  # for which a server's word holds that a client is there
GONE_SECONDS = 600.0  # for a client to come at all
LIFE_SECONDS = 86_400.0  # for a live submission to end, however its client comes and goes
SEATS_OF_OWNER = 16  # connections of one lab at once


@dataclasses.dataclass(frozen=True)
class Asked:
    """A worker's question to a live robot, and the lease that allows it."""

    submission: str
    job: str
    lease: str
    step: Step
    question: bytes


class Seats:
    """The rows, as one server sees them."""

    def __init__(self, database: Database, clock: Clock) -> None:
        self._database, self._clock = database, clock
        self._began = clock()  # while no server ran nobody could come

    def take(self, submission: str, owner: str) -> str:
        """Give a submission's place to a new connection, and return its name.

        The connection before it, at whatever server, has lost the place.

        Raises:
            Problem: The lab has too many connections.
        """
        seat, now = new_id(), self._clock()
        mine = SEAT.submission == submission
        with self._database.write() as connection:
            self._database.one_at_a_time(connection, f"seats {owner}")
            others = sa.select(sa.func.count()).where(SEAT.owner == owner, SEAT.until > now, ~mine)
            if connection.execute(others).scalar_one() >= SEATS_OF_OWNER:
                message = f"at most {SEATS_OF_OWNER} live robots of a lab play at once"
                raise Problem("too_many_requests", f"{message}; try again later")
            values = {"seat": seat, "until": now + SEAT_SECONDS, "seen_at": now}
            row = {"submission": submission, "owner": owner, "thought": 0.0, **values}
            if not insert_once(connection, schema.seats, row):
                connection.execute(sa.update(schema.seats).where(mine).values(values))
        return seat

    def keep(self, seats: Mapping[str, str]) -> dict[str, str]:
        """Say that connections are there, each by its token's id; return the submissions' states.

        Those that were replaced, or whose tokens were revoked, are left out.
        """
        mine, now = SEAT.seat.in_(seats), self._clock()
        valid = sa.select(TOKEN.id).where(TOKEN.id.in_(seats.values()), TOKEN.revoked_at.is_(None))
        states = sa.select(SEAT.seat, SUBMISSION.state).join(schema.submissions).where(mine)
        with self._database.write() as connection:
            values = {"until": now + SEAT_SECONDS, "seen_at": now}
            connection.execute(sa.update(schema.seats).where(mine).values(values))
            tokens = set(connection.execute(valid).scalars())
            rows = connection.execute(states)
            return {row.seat: row.state for row in rows if seats[row.seat] in tokens}

    def leave(self, submission: str, seat: str, thought: float) -> None:
        """Note that a connection is over, and how long its robot has thought."""
        now, mine = self._clock(), SEAT.submission == submission
        with self._database.write() as connection:
            over = sa.update(schema.seats).where(mine, SEAT.seat == seat)
            connection.execute(over.values(seat=None, until=now, seen_at=now))
            _add_thought(connection, submission, thought)

    def think(self, submission: str, seconds: float) -> float:
        """Count time for which a step has waited for a robot; return all of it."""
        with self._database.write() as connection:
            return _add_thought(connection, submission, seconds)

    def gone(self) -> list[str]:
        """Return the live submissions whose clients have not come for too long."""
        now = self._clock()
        seen = sa.func.coalesce(SEAT.seen_at, SUBMISSION.created_at)
        away = (seen < now - GONE_SECONDS) & (sa.func.coalesce(SEAT.until, 0.0) < now)
        is_over = SUBMISSION.created_at < now - LIFE_SECONDS
        if now - self._began > GONE_SECONDS:
            is_over |= away
        live = (SUBMISSION.kind == "live") & SUBMISSION.state.not_in(FINAL_STATES)
        query = sa.select(SUBMISSION.id).outerjoin(schema.seats).where(live, is_over)
        with self._database.read() as connection:
            return list(connection.execute(query).scalars())

    def put(self, asked: Asked) -> bool:
        """Leave a question for the server that has the connection; False if the lease is lost."""
        mine = SEAT.submission == asked.submission
        with self._database.write() as connection:
            job = held_job(connection, asked.job, asked.lease)
            query = sa.select(SEAT.batch, SEAT.step, SEAT.question).where(mine)
            row = connection.execute(query).first()
            if job is None or job.state != "leased" or row is None:
                return False
            if row.question is None or is_newer(asked.step, (row.batch, row.step)):
                step = {"batch": asked.step[0], "step": asked.step[1]}
                values = {**step, "question": asked.question, "answer": None}
                connection.execute(sa.update(schema.seats).where(mine).values(values))
        return True

    def answer(self, submission: str, step: Step) -> tuple[bytes | None, float]:
        """Return the answer to a step that was `put`, and for how long the client is away."""
        now = self._clock()
        query = sa.select(schema.seats).where(SEAT.submission == submission)
        with self._database.read() as connection:
            row = connection.execute(query).first()
        if row is None:
            return None, 0.0
        away = 0.0 if row.until > now else now - max(row.seen_at, self._began)
        return (row.answer if (row.batch, row.step) == step else None), away

    def pending(self) -> list[Any]:
        """Return what was asked of connections at other servers, and not answered."""
        columns = SEAT.seat, SEAT.submission, SEAT.batch, SEAT.step, SEAT.question
        asked = SEAT.question.is_not(None), SEAT.answer.is_(None)
        query = sa.select(*columns).where(SEAT.seat.is_not(None), *asked)
        with self._database.read() as connection:
            return list(connection.execute(query))

    def answered(self, submission: str, step: Step, answer: bytes) -> None:
        """Leave the answer to a question for the server at which it was asked."""
        this = SEAT.submission == submission, SEAT.batch == step[0], SEAT.step == step[1]
        with self._database.write() as connection:
            connection.execute(sa.update(schema.seats).where(*this).values(answer=answer))


def _add_thought(connection: sa.Connection, submission: str, seconds: float) -> float:
    mine = sa.update(schema.seats).where(SEAT.submission == submission)
    counted = mine.values(thought=SEAT.thought + seconds).returning(SEAT.thought)
    return connection.execute(counted).scalar() or 0.0
