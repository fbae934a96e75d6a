"""Acts of an organiser on submissions, labs and seasons, each with a ledger entry."""

import dataclasses
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from assistax_board.problems import Problem
from assistax_board.rules import closing, entries, jobs, submissions
from assistax_board.rules.catalogue import version_id
from assistax_board.rules.seasons import MAX_OPEN_SECONDS, check_date
from assistax_board.store import schema
from assistax_board.store.database import Database, Transaction
from assistax_board.store.notices import withdraw_notice
from assistax_board.store.queries import unplayed_b
from assistax_board.store.schema import (
    ARTEFACT,
    DECLARED,
    ERASED,
    JOB,
    RECEIPT,
    SEASON,
    SUBMISSION,
    SUBMITTER,
    TOKEN,
)
from assistax_board.vocabulary import FINAL_STATES

if TYPE_CHECKING:
    from assistax_board.service import Service


@dataclasses.dataclass(frozen=True)
class Failure:
    """A submission of which jobs have failed."""

    submission: str
    lab: str
    method: str
    task: str
    season: str | None  # name
    state: str
    failures: int  # of the job that failed most often
    jobs: int  # that failed, and are not done


def failures(database: Database) -> list[Failure]:
    """Return the submissions of which jobs have failed, the newest first."""
    query = (
        sa.select(
            SUBMISSION.id,
            SUBMITTER.name,
            SUBMISSION.method,
            SUBMISSION.task,
            SEASON.name.label("season_name"),
            SUBMISSION.state,
            sa.func.max(JOB.failures),
            sa.func.count(),
        )
        .join(schema.jobs, JOB.submission == SUBMISSION.id)
        .join(schema.submitters, SUBMITTER.id == SUBMISSION.submitter)
        .outerjoin(schema.seasons, SEASON.id == SUBMISSION.season)
        .where(JOB.failures > 0, JOB.state != "done")
        .group_by(SUBMISSION.id, SUBMITTER.name, SEASON.name)
        .order_by(SUBMISSION.created_at.desc(), SUBMISSION.id)
    )
    with database.read() as connection:
        return [Failure(*row) for row in connection.execute(query)]


def retry(service: "Service", id: str, *, extra_attempt: bool = False) -> None:
    """Queue a submission again that workers failed, or its panel B in a closing season.

    A submission takes the attempt again that its failure gave back. If its lab has used that one
    since, nothing is queued, unless the organiser gives it one more attempt than the season has.

    Args:
        service: The service.
        id: The submission.
        extra_attempt: Whether the lab may have one more attempt; the ledger says so.

    Raises:
        Problem: Workers did not fail it, its season takes no more, or the attempts are used up.
    """
    with service.begin() as transaction:
        # Locks its season too: no attempt is taken while one is given back.
        row = submissions.find_submission(transaction, id)
        if row is None:
            raise Problem("not_found", f"no submission {id!r}; `service failures` lists them")
        season = closing.season_of(transaction, id)
        entry: dict[str, Any] = {"id": id}
        if season is not None and id in unplayed_b(transaction, season.id):
            _retry_b(transaction, season, row)
            entry["panel"] = "B"
        elif (row.state, row.reason) == ("failed", "worker_errors"):
            if _retry_submission(service, transaction, row, season, extra_attempt):
                entry["extra_attempt"] = True
        else:
            raise Problem(
                "conflict",
                f"submission {id} is {row.state}{f' ({row.reason})' if row.reason else ''}; only "
                "submissions that failed with worker_errors can be queued again",
            )
        for kind in ("worker_errors", "panel_b"):
            withdraw_notice(transaction, kind, id)
        transaction.record("retry", entry)


def _retry_submission(
    service: "Service", transaction: Transaction, row: Any, season: Any, extra: bool
) -> bool:
    """Queue a failed submission; return whether its lab needed an extra attempt for it."""
    needs_extra = False
    if season is not None:
        _check_takes(transaction, season)
        needs_extra = entries.attempts_left(transaction, season, row.submitter) == 0
    if needs_extra and not extra:
        raise Problem(
            "budget_spent",
            f"the lab has used all {season.budget} attempts of season {season.name}, also the one "
            "that it got back; nothing was queued. Give it one more attempt than the season has, "
            "which the ledger will say, or leave the submission as it is",
        )
    attempt = "free" if season is None else "reserved"
    again = sa.update(schema.submissions).where(SUBMISSION.id == row.id)
    transaction.execute(
        again.values(state="queued", reason=None, finished_at=None, attempt=attempt)
    )
    version = version_id(service.catalogue.identity(row.task))
    if not jobs.queue_again(transaction, row.id, version):
        submissions.plan_jobs(transaction, service.catalogue, row._mapping, season)
    return needs_extra


def _retry_b(transaction: Transaction, season: Any, row: Any) -> None:
    """Queue the open jobs of panel B again, at the version that they have."""
    if season.state != "closing":
        raise Problem("too_late", f"season {season.name} closed without it")
    if row.state == "failed":  # a reference, which plays this panel alone
        again = sa.update(schema.submissions).where(SUBMISSION.id == row.id)
        transaction.execute(again.values(state="queued", reason=None, finished_at=None))
    jobs.queue_b_again(transaction, row.id)


def _check_takes(transaction: Transaction, season: Any) -> None:
    """Refuse a season that plays panel B, or is over."""
    of_b = (
        sa.select(JOB.id)
        .join(schema.submissions, SUBMISSION.id == JOB.submission)
        .where(SUBMISSION.season == season.id, JOB.panel == "B")
    )
    if season.state == "closed" or transaction.execute(of_b.limit(1)).first():
        raise Problem("too_late", f"season {season.name} plays panel B, or has played it")


def disqualify(service: "Service", season: str, lab: str) -> int:
    """Take a lab out of a season: its submissions leave the boards, and it can submit no more.

    Args:
        service: The service.
        season: Name or id.
        lab: Name.

    Returns:
        How many submissions that was.

    Raises:
        Problem: There is no such season or lab, or nothing of the lab stands in it.
    """
    with service.begin() as transaction:
        is_season = (SEASON.id == season) | (SEASON.name == season)
        season_row = transaction.execute(sa.select(schema.seasons).where(is_season)).first()
        owner = transaction.execute(sa.select(SUBMITTER.id).where(SUBMITTER.name == lab)).scalar()
        if season_row is None or owner is None:
            missing = f"season {season!r}" if season_row is None else f"lab {lab!r}"
            raise Problem("not_found", f"there is no {missing}")
        mine = SUBMISSION.season == season_row.id, SUBMISSION.submitter == owner
        standing = SUBMISSION.state.in_(("queued", "running", "scored"))
        rows = transaction.execute(sa.select(schema.submissions).where(*mine, standing)).all()
        if not rows:
            raise Problem("not_found", f"{lab} has no submission in season {season}")
        for row in rows:
            if row.state not in FINAL_STATES:
                submissions.end(transaction, row, "failed", "disqualified", "spent")
        values = {"state": "retracted", "reason": "disqualified", "entered_at": None}
        scored = sa.update(schema.submissions).where(*mine, SUBMISSION.state == "scored")
        transaction.execute(scored.values(values))
        for row in rows:
            jobs.cancel_jobs(transaction, row.id)
        body = {
            "season": season_row.id,
            "submitter": owner,
            "submissions": [row.id for row in rows],
        }
        transaction.record("disqualify", body)
        closing.take_next_step(transaction, season_row.id)
    return len(rows)


def extend(transaction: Transaction, name: str, closes_at: float) -> None:
    """Let an open season close later than was announced, or set the date of a draft.

    Raises:
        Problem: It is neither open nor a draft, or the date is not later.
    """
    query = sa.update(schema.seasons).where((SEASON.id == name) | (SEASON.name == name))
    query = query.where(SEASON.state == "draft").values(closes_at=closes_at)
    if transaction.execute(query).rowcount:  # of a draft nobody is told, and no ledger
        check_date(transaction, closes_at)
        return
    row = closing.find_season(transaction, name, "open", in_time=True)
    if not (row.closes_at or transaction.now) < closes_at < transaction.now + MAX_OPEN_SECONDS:
        raise Problem(
            "invalid",
            f"season {row.name} has a closing date that labs rely on; give a later one, within "
            "three years from now, or close it by `season close`",
        )
    transaction.execute(
        sa.update(schema.seasons).where(SEASON.id == row.id).values(closes_at=closes_at)
    )
    body = {"season": row.id, "closes_at": closes_at}
    transaction.record("season_extend", body)


def delete_draft(service: "Service", name: str) -> None:
    """Delete a season that was never opened, and the release that was packed for it.

    Raises:
        Problem: There is none of this name, or it was opened: it is in the ledger, and stays.
    """
    with service.begin() as transaction:
        row = closing.find_season(transaction, name, "draft")
        transaction.execute(sa.delete(schema.seasons).where(SEASON.id == row.id))
        others = sa.select(SEASON.id).where(SEASON.release == row.release)
        gone = set() if transaction.execute(others).first() else {row.release}
        _mark_erased(transaction, gone)
    _erase_files(service, gone)


def erase_submitter(service: "Service", submitter: str) -> None:
    """Remove a person's data; the ledger holds ids and hashes alone, so its chain stays whole."""
    with service.begin() as transaction:
        where = SUBMITTER.id == submitter
        row = transaction.execute(sa.select(schema.submitters).where(where)).first()
        if row is None:
            raise Problem("not_found", f"no submitter {submitter!r}")
        transaction.execute(
            sa.update(schema.submitters)
            .where(where)
            .values(name=f"erased-{submitter}", contact=None, erased_at=transaction.now)
        )
        open_tokens = sa.update(schema.tokens).where(TOKEN.submitter == submitter)
        transaction.execute(open_tokens.values(revoked_at=transaction.now, label="erased"))
        mine = transaction.execute(
            sa.select(SUBMISSION.id, SUBMISSION.artefact, SUBMISSION.season).where(
                SUBMISSION.submitter == submitter
            )
        ).all()
        seasons = sorted({row.season for row in mine if row.season})
        for row in mine:
            submissions.fail(transaction, row.id, "withdrawn")
            jobs.cancel_jobs(transaction, row.id)  # of a scored one, whose file goes too
            update = sa.update(schema.submissions).where(SUBMISSION.id == row.id)
            # Its client chose the request, and may have written anything.
            nothing = dict.fromkeys(submissions.DESCRIPTION)
            transaction.execute(update.values(method="erased", request=row.id, **nothing))
            _sign_anew(service, transaction, row.id)
        theirs = sa.update(schema.entries).where(DECLARED.submitter == submitter)
        transaction.execute(theirs.values(method="erased", request=DECLARED.id, card={}))
        others = sa.select(SUBMISSION.artefact).where(
            SUBMISSION.submitter != submitter, SUBMISSION.artefact.is_not(None)
        )
        needed = set(transaction.execute(others).scalars())
        gone = {row.artefact for row in mine if row.artefact} - needed
        _mark_erased(transaction, gone)
        transaction.record("erase", {"submitter": submitter})
        for season in seasons:
            closing.take_next_step(transaction, season)
    _erase_files(service, gone)


def _mark_erased(transaction: Transaction, names: set[str]) -> None:
    mine = sa.update(schema.artefacts).where(ARTEFACT.sha256.in_(names))
    transaction.execute(mine.values(erased_at=transaction.now))


def _erase_files(service: "Service", names: set[str]) -> None:
    """Remove the files of artefacts that were marked as erased."""
    with service.begin() as transaction:
        # Another lab may have handed in such a file since; this transaction keeps new ones out.
        for name in transaction.execute(ERASED.where(ARTEFACT.sha256.in_(names))).scalars():
            service.artefacts.erase(name)


def _sign_anew(service: "Service", transaction: Transaction, submission: str) -> None:
    """Sign receipts without the method's name: the same score, at the same place of the ledger."""
    query = sa.select(RECEIPT.version, RECEIPT.content).where(RECEIPT.submission == submission)
    for row in transaction.execute(query).all():
        content = row.content | {"method": "erased"}
        mine = sa.update(schema.receipts).where(
            RECEIPT.submission == submission, RECEIPT.version == row.version
        )
        transaction.execute(mine.values(content=content, signature=service.signer.sign(content)))
