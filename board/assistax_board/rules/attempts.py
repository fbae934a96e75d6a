"""The attempts of a lab in a season: how many it has, and who has none."""

from typing import Any

import sqlalchemy as sa

from assistax_board.problems import Problem
from assistax_board.store import schema
from assistax_board.store.database import Transaction
from assistax_board.store.schema import SEASON, SUBMISSION


def open_season(transaction: Transaction, id: str, task: str) -> Any:
    """Return the row of a season that takes submissions now.

    Raises:
        Problem: There is none of this id and task, or it takes none.
    """
    row = transaction.execute(sa.select(schema.seasons).where(SEASON.id == id)).first()
    if row is None or row.task != task:
        raise Problem("not_found", f"no season {id!r} of task {task}")
    if row.state != "open":
        raise Problem("too_late", f"season {row.name} is {row.state}; it must be open")
    if row.closes_at is not None and row.closes_at <= transaction.now:
        raise Problem("too_late", f"the closing date of season {row.name} has passed")
    return row


def attempts_left(transaction: Transaction, season: Any, submitter: str) -> int:
    """Count attempts anew each time: a counter could be lost between two transactions."""
    query = sa.select(sa.func.count()).where(
        SUBMISSION.season == season.id,
        SUBMISSION.submitter == submitter,
        SUBMISSION.attempt.in_(("reserved", "spent")),
    )
    return max(0, season.budget - transaction.execute(query).scalar_one())


def check_attempts(transaction: Transaction, season: Any, submitter: str, needed: int = 1) -> None:
    """Refuse files of a lab that is out of a season, or has too few attempts left in it.

    Raises:
        Problem: Why the season takes them not.
    """
    _check_not_disqualified(transaction, season, submitter)
    if (left := attempts_left(transaction, season, submitter)) < needed:
        raise Problem(
            "budget_spent",
            f"{left} of {season.budget} attempts of season {season.name} are left and {needed} "
            "needed, one for each file; submit without a season to be scored on public partners",
        )


def _check_not_disqualified(transaction: Transaction, season: Any, submitter: str) -> None:
    out = SUBMISSION.submitter == submitter, SUBMISSION.reason == "disqualified"
    query = sa.select(SUBMISSION.id).where(SUBMISSION.season == season.id, *out)
    if transaction.execute(query.limit(1)).first():
        raise Problem("not_allowed", f"the organiser disqualified you from season {season.name}")
