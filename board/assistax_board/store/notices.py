"""Notices to the organiser, shown by `service check` and the organiser's page until cleared.

A notice is about one thing and counts how often that happened, so that nobody fills the table.
"""

import dataclasses

import sqlalchemy as sa

from assistax_board.store import schema
from assistax_board.store.database import Database, Transaction
from assistax_board.store.schema import NOTICE

KINDS = {
    "worker_errors": "a job of this submission failed at all its tries: see `service failures`; "
    "`service retry` queues it again",
    "panel_b": "workers could not play panel B of this submission, and its season waits a week: "
    "`service retry` queues it again; without that the season closes without it",
    "season_incomplete": "this season is closed without all entries, since workers failed them: "
    "its page and the ledger name them",
    "same_bytes": "labs handed in the same file, named here by its sha256; the first one has the "
    "place, and the page of the others says so",
    "unexpected": "a request met an error of the service itself; the log has it",
    "too_full": "the disk or the store took no more files, and submissions were refused",
    "ledger": "the ledger is no unbroken chain: somebody changed it; `service check` says more",
    "season_closed": "this season is closed, and its partners are revealed",
}
MAX_ABOUT = 200


@dataclasses.dataclass(frozen=True)
class Notice:
    """One thing that the organiser is to know."""

    kind: str  # a word of `KINDS`
    about: str  # such as a submission's id
    count: int  # how often it happened
    first_at: float
    last_at: float

    @property
    def text(self) -> str:
        """Meaning of the notice, and the next step."""
        return KINDS[self.kind]


def note(transaction: Transaction, kind: str, about: str) -> None:
    """Add a notice in the transaction of its event; a repeated one is counted."""
    key = {"kind": kind, "about": about[:MAX_ABOUT]}
    row = {**key, "count": 1, "first_at": transaction.now, "last_at": transaction.now}
    if not transaction.insert_once(schema.notices, row):
        again = sa.update(schema.notices).where(*_is(**key))
        transaction.execute(again.values(count=NOTICE.count + 1, last_at=transaction.now))


def list_notices(database: Database) -> list[Notice]:
    """Return the notices, the newest first."""
    query = sa.select(schema.notices).order_by(NOTICE.last_at.desc(), NOTICE.kind, NOTICE.about)
    with database.read() as connection:
        return [Notice(**row) for row in connection.execute(query).mappings()]


def clear_notices(database: Database, until: float) -> None:
    """Delete the notices of events until a time, which were read."""
    with database.write() as connection:
        connection.execute(sa.delete(schema.notices).where(NOTICE.last_at <= until))


def withdraw_notice(transaction: Transaction, kind: str, about: str) -> None:
    """Delete a notice whose cause was repaired."""
    transaction.execute(sa.delete(schema.notices).where(*_is(kind, about)))


def _is(kind: str, about: str) -> tuple[sa.ColumnElement[bool], ...]:
    return NOTICE.kind == kind, NOTICE.about == about
