"""The queue of submissions: places, and the time left."""

import itertools
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from assistax_board.store import schema
from assistax_board.store.schema import JOB, RESULT, SUBMISSION, UNFROZEN
from assistax_board.store.shown import Submission
from assistax_board.vocabulary import FINAL_STATES, REASONS

DEFAULT_JOB_SECONDS = 20.0  # of a job, before any was timed


class Queue:
    """Order and waiting times of the submissions, as one transaction sees them."""

    def __init__(self, connection: sa.Connection, shown: Sequence[str]) -> None:
        """Read the waiting submissions, and the jobs of those that will be described."""
        is_waiting = SUBMISSION.state.not_in(FINAL_STATES)
        counts = (
            sa.select(JOB.submission, JOB.state, sa.func.count())
            .join(schema.submissions)
            .where(is_waiting | SUBMISSION.id.in_(shown))
            .group_by(JOB.submission, JOB.state)
        )
        self._jobs: dict[str, dict[str, int]] = {}
        for submission, state, count in connection.execute(counts):
            self._jobs.setdefault(submission, {})[state] = count
        # What lacks files of its entry has no place in the queue.
        placed = is_waiting & (SUBMISSION.entry.is_(None) | SUBMISSION.entry.not_in(UNFROZEN))
        order = sa.select(SUBMISSION.id).where(placed)
        order = order.order_by(SUBMISSION.turn, SUBMISSION.created_at, SUBMISSION.id)
        ids = list(connection.execute(order).scalars())
        before = itertools.accumulate(map(self._left, ids))
        self._places = {id: place for id, *place in zip(ids, itertools.count(1), before)}
        recent = sa.select(RESULT.seconds).order_by(RESULT.created_at.desc()).limit(50)
        seconds = list(connection.execute(recent).scalars())
        self._job_seconds = sum(seconds) / len(seconds) if seconds else DEFAULT_JOB_SECONDS
        leased = sa.select(sa.func.count(sa.distinct(JOB.worker))).where(JOB.state == "leased")
        self._workers = max(1, connection.execute(leased).scalar_one())

    def describe(self, row: Any) -> Submission:
        """Return a submission with its place and the time left."""
        jobs = self._jobs.get(row.id, {})
        place, left = self._places.get(row.id, (None, None))
        eta = None if left is None else left * self._job_seconds / self._workers
        live = {name: count for name, count in jobs.items() if name != "cancelled"}
        return Submission(
            id=row.id,
            submitter=row.submitter_name,
            task=row.task,
            method=row.method,
            kind=row.kind,
            season=row.season,
            state=row.state,
            reason=row.reason,
            reason_text=REASONS.get(row.reason or ""),
            attempt=row.attempt,
            created_at=row.created_at,
            finished_at=row.finished_at,
            artefact=row.artefact,
            licence=row.licence,
            place=place,
            eta_seconds=eta,
            jobs_done=live.get("done", 0),
            jobs=sum(live.values()),
            entered=row.entered_at is not None,
            about=row.about,
            link=row.link,
            citation=row.citation,
            warning=row.warning,
            entry=row.entry,
            declared=None if row.files is None else len(row.files),
            reference=row.format if row.kind == "reference" else None,
            card=row.card,
        )

    def _left(self, submission: str) -> int:
        jobs = self._jobs.get(submission, {})
        return jobs.get("waiting", 0) + jobs.get("leased", 0)
