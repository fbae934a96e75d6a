"""The queue: jobs that are leased, and come back when their worker does not.

A lease is a promise to answer by a time. Who dies breaks it, the lease runs out, and the next
worker takes the job; so nothing has to notice a death. A job may thus be done twice: its result is
accepted once (see `results`).
"""

import dataclasses
import secrets
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from assistax_base.digest import sha256
from assistax_board.ids import new_id
from assistax_board.store import schema
from assistax_board.store.database import Reader, Transaction
from assistax_board.store.schema import JOB, MAX_FAILURES, SUBMISSION

OPEN = ("held", "waiting", "leased")  # states of a job that is not finished
LEASE_SECONDS = 60.0
CLOCKS_APART = 60.0  # a lease that begins later than this is of a clock that was set back


@dataclasses.dataclass(frozen=True)
class Lease:
    """A job that a worker holds; the secret proves which worker."""

    job: str
    secret: str
    submission: str
    version: str
    panel: str
    chunk: int


def add_jobs(
    transaction: Transaction,
    submission: str,
    version: str,
    panel: str,
    chunks: int,
    *,
    turn: int,
    held: bool = False,
) -> None:
    """Add a job for each chunk of a panel; `turn` orders them, see `submissions`."""
    common = {
        "submission": submission,
        "version": version,
        "panel": panel,
        "state": "held" if held else "waiting",
        "failures": 0,
        "turn": turn,
        "created_at": transaction.now,
    }
    rows = [{"id": new_id(), "chunk": chunk, **common} for chunk in range(chunks)]
    transaction.execute(sa.insert(schema.jobs), rows)


def lease_job(
    transaction: Transaction, worker: str, versions: Sequence[str]
) -> tuple[Lease | None, list[str]]:
    """Take the next job that a worker of these versions can do.

    Returns:
        The lease, or None if nothing waits; and the submissions that have failed too often.
    """
    exhausted = expire_leases(transaction)
    query = sa.select(schema.jobs).where(JOB.state == "waiting", JOB.version.in_(versions))
    query = query.where(~_waits_for_earlier())
    order = query.order_by(JOB.turn, JOB.created_at, JOB.submission, JOB.panel, JOB.chunk).limit(1)
    row = transaction.execute(order).first()
    if row is None:
        return None, exhausted
    secret = secrets.token_urlsafe(32)
    values = {
        "state": "leased",
        "lease": sha256(secret.encode()),
        "worker": worker,
        "leased_at": transaction.now,
        "expires_at": transaction.now + LEASE_SECONDS,
    }
    transaction.execute(sa.update(schema.jobs).where(JOB.id == row.id).values(values))
    begun = (SUBMISSION.id == row.submission) & (SUBMISSION.state == "queued")
    transaction.execute(sa.update(schema.submissions).where(begun).values(state="running"))
    return Lease(row.id, secret, row.submission, row.version, row.panel, row.chunk), exhausted


def _waits_for_earlier() -> sa.ColumnElement[bool]:
    """Return whether a job of panel A must wait: an attempt that was answered earlier is replayed.

    The Ladder compares an attempt with those of its lab before it. So they come in one order,
    however many workers play them anew after an upgrade.
    """
    mine, other = schema.submissions.alias(), schema.submissions.alias()
    replay = schema.jobs.alias()
    order = sa.tuple_(other.c.finished_at, other.c.id) < sa.tuple_(mine.c.finished_at, mine.c.id)
    query = (
        sa.select(other.c.id)
        .select_from(mine)
        .join(other, (other.c.season == mine.c.season) & (other.c.submitter == mine.c.submitter))
        .join(replay, replay.c.submission == other.c.id)
        .where(mine.c.id == JOB.submission, mine.c.finished_at.is_(None) | order)
        .where(other.c.state == "scored", replay.c.version == JOB.version)
        .where(replay.c.panel != "B", replay.c.state.in_(OPEN))
    )
    return (JOB.panel == "A") & query.exists()


def expire_leases(transaction: Transaction) -> list[str]:
    """Put jobs of broken leases back; return the submissions whose jobs failed too often.

    A lease that begins far in the future was given before the clock was set back. Its age is
    unknown, so it counts as expired.
    """
    broken = (JOB.expires_at < transaction.now) | (JOB.leased_at > transaction.now + CLOCKS_APART)
    query = sa.select(schema.jobs).where(JOB.state == "leased", broken)
    rows = transaction.execute(query).all()
    for row in rows:
        _put_back(transaction, row)
    return [row.submission for row in rows if row.failures + 1 >= MAX_FAILURES]


def beat(transaction: Transaction, job: str, secret: str) -> bool:
    """Extend a lease; return False if it expired, so that the worker stops."""
    values = {"leased_at": transaction.now, "expires_at": transaction.now + LEASE_SECONDS}
    held = sa.update(schema.jobs).where(*_held(job, secret)).values(values)
    return transaction.execute(held).rowcount == 1


def give_back(transaction: Transaction, job: str, secret: str) -> None:
    """Return a job undone, by a worker that stops; this is no failure."""
    held = sa.update(schema.jobs).where(*_held(job, secret))
    transaction.execute(held.values(state="waiting", lease=None, expires_at=None))


def fail_job(transaction: Transaction, job: str, secret: str) -> str | None:
    """Put back a job that a worker could not do; name its submission if it failed too often."""
    row = transaction.execute(sa.select(schema.jobs).where(*_held(job, secret))).first()
    if row is None:
        return None
    _put_back(transaction, row)
    return row.submission if row.failures + 1 >= MAX_FAILURES else None


def held_job(reader: Reader, job: str, secret: str) -> Any:
    """Return the row of a job that this lease was the last to hold, also after it ran out."""
    row = reader.execute(sa.select(schema.jobs).where(JOB.id == job)).first()
    return row if row is not None and row.lease == sha256(secret.encode()) else None


def release_held(transaction: Transaction, submission: str, version: str) -> None:
    """Let the hidden panels of a submission be played, once its public panel is done."""
    where = (JOB.submission == submission) & (JOB.version == version) & (JOB.state == "held")
    transaction.execute(sa.update(schema.jobs).where(where).values(state="waiting"))


def cancel_jobs(transaction: Transaction, submission: str, version: str | None = None) -> None:
    """Cancel the unfinished jobs of a submission, of one version or of all."""
    where = (JOB.submission == submission) & JOB.state.in_(OPEN)
    where = where if version is None else where & (JOB.version == version)
    transaction.execute(sa.update(schema.jobs).where(where).values(state="cancelled"))


def drop_other_versions(transaction: Transaction, task: str, version: str) -> None:
    """Cancel the unfinished jobs of a task that no worker of this version can do."""
    of_task = sa.select(SUBMISSION.id).where(SUBMISSION.task == task)
    where = JOB.submission.in_(of_task), JOB.version != version
    dropped = sa.update(schema.jobs).where(*where, JOB.state.in_(OPEN))
    transaction.execute(dropped.values(state="cancelled"))


def queue_again(
    transaction: Transaction, submission: str, version: str, *, hidden: bool = True
) -> bool:
    """Queue the cancelled jobs of a submission again; return False if it has no jobs.

    Its hidden panel is held back until the public one is done, and left out unless `hidden`.
    """
    mine = JOB.submission == submission, JOB.version == version
    jobs = transaction.execute(sa.select(JOB.panel, JOB.state).where(*mine)).all()
    held = any(panel == "public" and state != "done" for panel, state in jobs)
    states = {"public": "waiting"} | ({"A": "held" if held else "waiting"} if hidden else {})
    for panel, state in states.items():
        again = sa.update(schema.jobs).where(*mine, JOB.panel == panel, JOB.state == "cancelled")
        transaction.execute(again.values(state=state, failures=0, lease=None, expires_at=None))
    return bool(jobs)


def queue_b_again(transaction: Transaction, submission: str) -> None:
    """Queue the cancelled jobs of panel B again, with no failures counted."""
    again = sa.update(schema.jobs).where(
        JOB.submission == submission, JOB.panel == "B", JOB.state == "cancelled"
    )
    transaction.execute(again.values(state="waiting", failures=0, lease=None, expires_at=None))


def _put_back(transaction: Transaction, job: Any) -> None:
    """Let another worker try a job again; give its panel up if it failed too often."""
    # The lease's hash stays: should its worker answer after all, the answer counts.
    failures = job.failures + 1
    state = "cancelled" if failures >= MAX_FAILURES else "waiting"
    values = {"state": state, "failures": failures, "expires_at": None}
    transaction.execute(sa.update(schema.jobs).where(JOB.id == job.id).values(values))
    if state == "cancelled" and job.panel != "B":  # a replay's panels can be scored no more
        cancel_jobs(transaction, job.submission, job.version)


def _held(job: str, secret: str) -> tuple[Any, ...]:
    return JOB.id == job, JOB.state == "leased", JOB.lease == sha256(secret.encode())
