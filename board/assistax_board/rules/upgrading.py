"""After an upgrade, plan every submission at the new version, unless a season is closing."""

from typing import TYPE_CHECKING

import sqlalchemy as sa

from assistax_board.problems import Problem
from assistax_board.rules import closing, jobs, submissions
from assistax_board.rules.catalogue import version_id
from assistax_board.rules.release_pack import check_program
from assistax_board.store import schema
from assistax_board.store.schema import (
    ERASED,
    JOB,
    MAX_FAILURES,
    SEASON,
    SUBMISSION,
    UNFROZEN,
    VERSION,
)

if TYPE_CHECKING:
    from assistax_board.service import Service


def adopt_version(service: "Service") -> int:
    """Plan jobs of the current version for each submission that has none; return their number.

    Unfinished jobs of older versions are dropped, since no worker of today can do them. Scores of
    older versions stay.

    Raises:
        Problem: A season is closing under another version, or has persons of another program;
            nothing was changed.
    """
    changed = 0
    _check_programs(service)
    for task in service.catalogue.tasks:
        _check_closing(service, task)
    for task in service.catalogue.tasks:
        version = version_id(service.catalogue.identity(task))
        with service.begin() as transaction:
            planned = sa.select(JOB.submission).where(JOB.version == version)
            stale = sa.select(schema.submissions).where(
                SUBMISSION.task == task,
                SUBMISSION.state.in_(("queued", "running", "scored")),
                # A season's references play panel B alone.
                (SUBMISSION.kind != "reference") | SUBMISSION.season.is_(None),
                SUBMISSION.id.not_in(planned),
                SUBMISSION.entry.is_(None) | SUBMISSION.entry.not_in(UNFROZEN),
                # Nobody has the file of an erased lab.
                SUBMISSION.artefact.is_(None) | SUBMISSION.artefact.not_in(ERASED),
            )
            for row in transaction.execute(stale).mappings().all():
                jobs.cancel_jobs(transaction, row["id"])
                season = closing.season_of(transaction, row["id"])
                season = season if season is not None and season.state == "open" else None
                submissions.plan_jobs(transaction, service.catalogue, row, season)
                changed += 1
    return changed


def _check_programs(service: "Service") -> None:
    """Refuse to play on with the persons of a season that were made by another program."""
    query = sa.select(SEASON.name, SEASON.secret).where(SEASON.state.in_(("open", "closing")))
    with service.database.read() as connection:
        for name, secret in connection.execute(query):
            check_program(name, secret["leaves"])


def _check_closing(service: "Service", task: str) -> None:
    """Refuse another version while a season closes: one version plays all of its submissions."""
    identity = service.catalogue.identity(task)
    query = (
        sa.select(SEASON.name, VERSION.identity)
        .join(schema.submissions, SUBMISSION.season == SEASON.id)
        .join(schema.jobs, JOB.submission == SUBMISSION.id)
        .join(schema.versions, VERSION.id == JOB.version)
        .where(SUBMISSION.task == task, SEASON.state == "closing")
        .where(JOB.version != version_id(identity))
        .where(
            JOB.state.in_(("held", "waiting", "leased"))
            | ((JOB.panel == "B") & (JOB.failures >= MAX_FAILURES))  # may be queued again
        )
    )
    with service.database.read() as connection:
        row = connection.execute(query.limit(1)).first()
    if row is not None:
        names = sorted(row.identity.keys() | identity.keys())
        changed = [n for n in names if row.identity.get(n) != identity.get(n)]
        differences = "; ".join(
            f"{n} {row.identity.get(n)}, now {identity.get(n)}" for n in changed
        )
        raise Problem(
            "conflict",
            f"season {row.name} is closing, and one version must play all that was handed in "
            f"({differences}); start the version and options with which the closing began until "
            "the season is closed",
        )
