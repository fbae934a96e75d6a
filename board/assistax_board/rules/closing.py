"""The end of a season: submissions that came in time are played, then entries play panel B.

    open -> closing -> closed
            |  |  `- all of panel B is played: everything is revealed
            |  `---- nothing is left of panel A: entries and references play panel B
            `------- nobody hands in any more

What workers failed in the meantime is waited for: an organiser may queue it again for a week, then
the season goes on without it and says so.

A lab may try often on panel A, and decides before the close what plays panel B: at most two
methods, each whole: a declared entry with all of its seeds, or all single robots of one name. Who
decides nothing plays the whole method whose score on panel A was shown last, of declared entries
if there are any.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from assistax_board.ids import new_id
from assistax_board.problems import Problem
from assistax_board.rules import jobs, submissions
from assistax_board.rules.release_pack import secret_persons
from assistax_board.store import schema
from assistax_board.store.database import Reader, Transaction
from assistax_board.store.notices import note
from assistax_board.store.queries import unplayed_b
from assistax_board.store.schema import (
    ERASED,
    JOB,
    SCORE,
    SEASON,
    SUBMISSION,
    SUBMITTER,
    UNFROZEN,
)
from assistax_board.vocabulary import FINAL_STATES, GONE_STATES, REFERENCE

if TYPE_CHECKING:
    from assistax_board.service import Service

ENTRIES = 2  # methods of one lab on panel B
WAIT_SECONDS = 7 * 86_400.0  # for the organiser to queue again what workers failed


def enter(transaction: Transaction, season: str, submitter: str, chosen: Sequence[str]) -> None:
    """Replace a lab's choice of methods for panel B.

    Args:
        transaction: In which the choice is recorded.
        season: Name or id.
        submitter: Id of the lab.
        chosen: Ids of its submissions; each stands for its whole method.

    Raises:
        Problem: The season is not open, or the choice is not within the rules.
    """
    row = find_season(transaction, season, "open", in_time=True)
    mine = SUBMISSION.season == row.id, SUBMISSION.submitter == submitter
    rows = transaction.execute(sa.select(schema.submissions).where(*mine)).all()
    methods = _check({row.id: row for row in rows}, chosen)
    entered = [row.id for row in rows if _method(row) in methods and row.state not in GONE_STATES]
    transaction.execute(sa.update(schema.submissions).where(*mine).values(entered_at=None))
    transaction.execute(
        sa.update(schema.submissions)
        .where(SUBMISSION.id.in_(entered))
        .values(entered_at=transaction.now)
    )
    body = {"season": row.id, "submitter": submitter, "submissions": sorted(entered)}
    transaction.record("entry", body)


def _method(row: Any) -> tuple[str, str, str | None]:
    """Return what the submissions of one method have in common."""
    return row.submitter, row.method, row.entry


def _check(rows: dict[str, Any], chosen: Sequence[str]) -> set[tuple[str, str, str | None]]:
    """Return the methods of the chosen submissions."""
    if missing := set(chosen) - rows.keys():
        raise Problem("not_found", f"you have no submission {min(missing)} in this season")
    if ended := [id for id in chosen if rows[id].state in GONE_STATES]:
        raise Problem("invalid", f"submission {ended[0]} is {rows[ended[0]].state}")
    methods = {_method(rows[id]) for id in chosen}
    if len(methods) > ENTRIES:
        raise Problem("invalid", f"{len(methods)} methods; a lab enters at most {ENTRIES}")
    return methods


def close_season(transaction: Transaction, name: str) -> None:
    """Close an open season to submissions; those that it has are still played."""
    row = find_season(transaction, name, "open")
    _close(transaction, row.id)


def close_due(service: "Service") -> None:
    """Close the seasons whose date has come, and advance those whose jobs are done."""
    now = service.clock()
    due = sa.select(SEASON.id).where(SEASON.state == "open", SEASON.closes_at <= now)
    closing = sa.select(schema.seasons).where(SEASON.state == "closing")
    with service.database.read() as connection:
        rows = connection.execute(closing).all()
        ready = [row.id for row in rows if not _waits(connection, row, now)]
        ready += connection.execute(due).scalars()
    for season in ready:
        with service.begin() as transaction:
            if transaction.execute(due.where(SEASON.id == season)).first():
                _close(transaction, season)
            else:
                take_next_step(transaction, season)


def take_next_step(transaction: Transaction, season: str) -> None:
    """Take a closing season to its next step, if all of the one before is done."""
    row = transaction.execute(sa.select(schema.seasons).where(SEASON.id == season)).one()
    if row.state != "closing" or _waits(transaction, row, transaction.now):
        return
    if not _states_of_b(transaction, season) and (entries := _entries(transaction, season)):
        _play_b(transaction, row, entries)
    else:
        _reveal(transaction, row)


def _waits(reader: Reader, season: Any, now: float) -> bool:
    """Return whether a closing season has open jobs, or failed ones that may be queued again."""
    if states := _states_of_b(reader, season.id):
        failed_at = unplayed_b(reader, season.id).values()
        is_mended = any(at > now - WAIT_SECONDS for at in failed_at)
        return is_mended or bool({"held", "waiting", "leased"} & states)
    of_labs = SUBMISSION.season == season.id, SUBMISSION.kind != "reference"
    # What failed before the season began to close was the lab's to hand in again.
    since = max(season.closes_at or 0.0, now - WAIT_SECONDS)
    mendable = (SUBMISSION.reason == "worker_errors") & (SUBMISSION.finished_at > since)
    waiting = SUBMISSION.state.not_in(FINAL_STATES) | mendable
    query = sa.select(SUBMISSION.id).where(*of_labs, waiting)
    return reader.execute(query.limit(1)).first() is not None


def _states_of_b(reader: Reader, season: str) -> set[str]:
    query = (
        sa.select(JOB.state)
        .join(schema.submissions, SUBMISSION.id == JOB.submission)
        .where(SUBMISSION.season == season, JOB.panel == "B")
    )
    return set(reader.execute(query).scalars())


def find_season(transaction: Transaction, name: str, state: str, *, in_time: bool = False) -> Any:
    """Return a season by its name or id, if it is in this state.

    Args:
        transaction: In which the season is read.
        name: Name or id.
        state: That it must be in.
        in_time: Whether a season whose closing date has come is refused.

    Raises:
        Problem: There is none, or it is in another state.
    """
    query = sa.select(schema.seasons).where((SEASON.id == name) | (SEASON.name == name))
    row = transaction.execute(query).first()
    if row is None:
        raise Problem(
            "not_found", f"no season {name!r}; GET /api/seasons lists the open and closed ones"
        )
    if row.state != state:
        raise Problem("too_late", f"season {row.name} is {row.state}; expected {state}")
    if in_time and row.closes_at is not None and row.closes_at <= transaction.now:
        raise Problem("too_late", f"the closing date of season {row.name} has passed")
    return row


def season_of(reader: Reader, submission: str) -> Any:
    """Return the season of a submission, secrets included: never to be shown."""
    query = sa.select(schema.seasons).join(schema.submissions, SUBMISSION.season == SEASON.id)
    return reader.execute(query.where(SUBMISSION.id == submission)).first()


def _close(transaction: Transaction, season: str) -> None:
    mine = SEASON.id == season
    closes_at = transaction.execute(sa.select(SEASON.closes_at).where(mine)).scalar()
    values = {"state": "closing", "closes_at": min(transaction.now, closes_at or transaction.now)}
    transaction.execute(sa.update(schema.seasons).where(mine).values(values))
    # What lacks files takes no more of them.
    waiting = sa.select(SUBMISSION.id).where(SUBMISSION.season == season)
    for id in transaction.execute(waiting.where(SUBMISSION.entry.in_(UNFROZEN))).scalars().all():
        submissions.fail(transaction, id, "season_closed")
    transaction.record("season_close", {"season": season})
    take_next_step(transaction, season)


def _entries(transaction: Transaction, season: str) -> list[Any]:
    """Return the submissions that play panel B: whole methods, entered or by default."""
    query = sa.select(schema.submissions).where(
        SUBMISSION.season == season, SUBMISSION.kind == "file"
    )
    query = query.where(SUBMISSION.artefact.not_in(ERASED))
    scored = transaction.execute(query.where(SUBMISSION.state == "scored")).all()
    by_lab: dict[str, list[Any]] = {}
    for row in scored:
        by_lab.setdefault(row.submitter, []).append(row)
    shown = _shown(transaction, season)
    return [
        row
        for lab in sorted(by_lab)
        for methods in [
            {_method(row) for row in by_lab[lab] if row.entered_at is not None}
            or _default(by_lab[lab], shown)
        ]
        for row in by_lab[lab]
        if _method(row) in methods
    ]


def _default(rows: Sequence[Any], shown: Sequence[str]) -> set[tuple[str, str, str | None]]:
    """Return the method of a lab that entered none: the one shown last, or none.

    Args:
        rows: The lab's scored submissions.
        shown: Submissions whose score on panel A was shown, the first one first.
    """
    declared = [row for row in rows if row.entry is not None]
    known = [row for row in declared or rows if row.id in shown]
    last = max(known, key=lambda row: shown.index(row.id), default=None)
    if last is None and declared:  # it was played, and the Ladder said nothing of it
        last = max(declared, key=lambda row: (row.created_at, row.id))
    return set() if last is None else {_method(last)}


def _shown(transaction: Transaction, season: str) -> list[str]:
    """Return the standing submissions whose score on panel A was shown, the first one first."""
    query = (
        sa.select(SUBMISSION.id)
        .join(schema.scores, SCORE.submission == SUBMISSION.id)
        .where(SUBMISSION.season == season, SUBMISSION.state == "scored")
        .where(SCORE.panel == "A", SCORE.released.is_not(None))
        .order_by(SUBMISSION.finished_at, SUBMISSION.id)  # when each was first answered
    )
    return list(transaction.execute(query).scalars())


def _play_b(transaction: Transaction, season: Any, entries: list[Any]) -> None:
    """Queue panel B for the entries, and for the rows that they are measured by."""
    ids = [row.id for row in entries]
    # The version that they were planned under last: after an upgrade no worker plays another.
    newest = sa.select(JOB.version).where(JOB.submission.in_(ids))
    version = transaction.execute(newest.order_by(JOB.created_at.desc()).limit(1)).scalar_one()
    transaction.execute(
        sa.update(schema.submissions)
        .where(SUBMISSION.id.in_(ids))
        .values(entered_at=transaction.now)
    )
    chunks = submissions.count_chunks(season.panel_sizes["B"])
    for id in (*ids, *_references(transaction, season)):
        jobs.add_jobs(transaction, id, version, "B", chunks, turn=0)
    body = {"season": season.id, "submissions": sorted(ids)}
    transaction.record("season_entries", body)


def _references(transaction: Transaction, season: Any) -> list[str]:
    """Add the references of the public board to a season, and return their submissions."""
    from evaluation.figures.normalised import SELF_PLAY

    # Persons were trained with no robot.
    left_out = [SELF_PLAY] if secret_persons(season.secret["leaves"]) else []
    query = (
        sa.select(schema.submissions)
        .join(schema.submitters, SUBMITTER.id == SUBMISSION.submitter)
        .where(SUBMITTER.name == REFERENCE, SUBMISSION.kind == "reference")
        .where(SUBMISSION.format.not_in(left_out))
        .where(
            SUBMISSION.task == season.task,
            SUBMISSION.season.is_(None),
            SUBMISSION.state != "retracted",
        )
    )
    rows: list[dict[str, Any]] = [
        {
            **dict(row),
            "id": new_id(),
            "request": f"{season.id} {row['format']}",
            "season": season.id,
            "state": "queued",
            "reason": None,
            "turn": 0,
            "created_at": transaction.now,
            "finished_at": None,
        }
        for row in transaction.execute(query).mappings().all()
    ]
    if rows:
        transaction.execute(sa.insert(schema.submissions), rows)
    return [row["id"] for row in rows]


def _reveal(transaction: Transaction, season: Any) -> None:
    """Publish the leaves of a season; the weights go with them."""
    values = {"state": "closed", "closed_at": transaction.now}
    transaction.execute(sa.update(schema.seasons).where(SEASON.id == season.id).values(values))
    body = {"season": season.id, "root": season.root, "release": season.release}
    unplayed = sorted(unplayed_b(transaction, season.id))
    transaction.record("season_reveal", body | {"unplayed": unplayed})
    note(transaction, "season_incomplete" if unplayed else "season_closed", season.name)
