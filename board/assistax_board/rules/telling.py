"""Labs that are told by a webhook when a submission has ended: where, and of what."""

from collections.abc import Sequence

import sqlalchemy as sa

from assistax_board.rules.tokens import submitter_id
from assistax_board.store import schema
from assistax_board.store.database import Database
from assistax_board.store.schema import SUBMISSION, SUBMITTER
from assistax_board.vocabulary import FINAL_STATES


def set_webhook(database: Database, lab: str, url: str | None, now: float) -> str:
    """Tell a lab from now on at an address, or nowhere, and return the lab's id."""
    id = submitter_id(database, lab)
    with database.write() as connection:
        mine = sa.update(schema.submitters).where(SUBMITTER.id == id)
        connection.execute(mine.values(webhook=url))
        before = SUBMISSION.submitter == id, SUBMISSION.state.in_(FINAL_STATES)
        connection.execute(sa.update(schema.submissions).where(*before).values(told_at=now))
    return id


def untold(database: Database) -> dict[str, tuple[str, list[str]]]:
    """Return the address and the submissions, the oldest first, of each lab that is to be told."""
    query = (
        sa.select(SUBMITTER.id, SUBMITTER.webhook, SUBMISSION.id.label("submission"))
        .join(schema.submissions, SUBMISSION.submitter == SUBMITTER.id)
        .where(SUBMITTER.webhook.is_not(None), SUBMISSION.told_at.is_(None))
        .where(SUBMISSION.state.in_(FINAL_STATES))
        .order_by(SUBMISSION.finished_at)
    )
    labs: dict[str, tuple[str, list[str]]] = {}
    with database.read() as connection:
        for row in connection.execute(query):
            labs.setdefault(row.id, (row.webhook, []))[1].append(row.submission)
    return labs


def told(database: Database, submissions: Sequence[str], now: float) -> None:
    """Note that a lab knows how its submissions ended."""
    with database.write() as connection:
        these = sa.update(schema.submissions).where(SUBMISSION.id.in_(submissions))
        connection.execute(these.values(told_at=now))
