"""All questions of pages and the API to the database.

Every answer is safe to show to anybody: of hidden panels it holds what was released, never more.
Nothing here imports JAX or plays an episode.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import sqlalchemy as sa

from assistax_board.store import schema
from assistax_board.store.database import Database, Reader
from assistax_board.store.played import NOT_PEOPLE
from assistax_board.store.queue import Queue
from assistax_board.store.schema import (
    ARTEFACT,
    DECLARED,
    ENTRY,
    ERASED,
    JOB,
    MAX_FAILURES,
    PARTNER_SCORE,
    RECEIPT,
    SCORE,
    SEASON,
    SUBMISSION,
    SUBMITTER,
    VERSION,
)
from assistax_board.store.shown import (
    Attempts,
    LedgerEntry,
    PartnerScore,
    Score,
    Season,
    Submission,
)
from assistax_board.vocabulary import FINAL_STATES, GONE_STATES, PEOPLE

STATEMENT = (
    f"The partners are simulated: trained policies, or persons made of numbers. {NOT_PEOPLE}"
)


class Queries:
    """The questions that pages and the API may ask."""

    def __init__(
        self, database: Database, served: Callable[[str], str | None] = lambda task: None
    ) -> None:
        """Prepare to ask.

        Args:
            database: Of the board.
            served: Returns the id of the version that a task is scored under now.
        """
        self.database, self._served = database, served

    def submissions(
        self,
        *,
        task: str | None = None,
        submitter: str | None = None,
        season: str | None = None,
        method_of: str | None = None,
        scored_of: str | None = None,
        waiting: bool = False,
        limit: int = 100,
    ) -> list[Submission]:
        """Return the newest submissions first, or only those that have not ended.

        `submitter` is an id; `method_of` is that of a submission of the method; `scored_of` is the
        name of a lab, whose scored submissions of public boards are returned.
        """
        query = (
            _submission_query().order_by(SUBMISSION.created_at.desc(), SUBMISSION.id).limit(limit)
        )
        for column, value in (
            (SUBMISSION.task, task),
            (SUBMISSION.submitter, submitter),
            (SUBMISSION.season, season),
        ):
            query = query if value is None else query.where(column == value)
        query = query if method_of is None else query.where(_of_method(method_of))
        if scored_of is not None:
            query = query.where(SUBMITTER.name == scored_of, SUBMISSION.state == "scored")
            query = query.where((SUBMISSION.kind == "file") | SUBMISSION.season.is_(None))
        query = query.where(SUBMISSION.state.not_in(FINAL_STATES)) if waiting else query
        with self.database.read() as connection:
            rows = list(connection.execute(query))
            queue = Queue(connection, [row.id for row in rows])
            return [queue.describe(row) for row in rows]

    def published(self) -> list[Submission]:
        """Return a robot of each method that the zoo declared, the first by its name."""
        query = _submission_query().order_by(SUBMISSION.format)
        query = query.where(
            SUBMISSION.kind == "reference",
            SUBMISSION.entry.is_not(None),
            SUBMISSION.season.is_(None),
            SUBMISSION.state.not_in(GONE_STATES),
        )
        first: dict[str, Any] = {}
        with self.database.read() as connection:
            for row in connection.execute(query):
                first.setdefault(row.entry, row)
            queue = Queue(connection, [row.id for row in first.values()])
            return [queue.describe(row) for row in first.values()]

    def submission(self, id: str) -> Submission | None:
        """Return one submission, if there is one of this id."""
        with self.database.read() as connection:
            row = connection.execute(_submission_query().where(SUBMISSION.id == id)).first()
            return None if row is None else Queue(connection, [id]).describe(row)

    def scores(
        self,
        *,
        task: str | None = None,
        submission: str | None = None,
        panel: str | None = None,
        season: str | None = None,
        version: str | None = None,
        method_of: str | None = None,
        newest: int | None = None,
    ) -> list[Score]:
        """Return released scores, the oldest first; of `newest` so many of the last ones.

        `version` is an id, see `versions`; `method_of` is that of a submission of the method.
        """
        query = (
            sa.select(
                schema.scores,
                SUBMISSION.task,
                SUBMISSION.method,
                SUBMITTER.name.label("submitter_name"),
            )
            .join(schema.submissions, SUBMISSION.id == SCORE.submission)
            .join(schema.submitters, SUBMITTER.id == SUBMISSION.submitter)
            .where(SCORE.released.is_not(None))
            .order_by(SCORE.created_at.desc(), SCORE.submission.desc(), SCORE.panel)
            .limit(newest)
        )
        if submission is None:  # off every board; its own page still tells
            query = query.where(
                (SUBMISSION.state != "retracted")
                | ((SCORE.panel == "B") & (SUBMISSION.reason != "disqualified"))
            )
        conditions = (
            (SUBMISSION.task, task),
            (SCORE.submission, submission),
            (SCORE.panel, panel),
            (SUBMISSION.season, season),
            (SCORE.version, version),
        )
        for column, value in conditions:
            query = query if value is None else query.where(column == value)
        query = query if method_of is None else query.where(_of_method(method_of))
        with self.database.read() as connection:
            return [_score(row) for row in connection.execute(query)][::-1]

    def partner_scores(
        self, submissions: Sequence[str], version: str | None = None
    ) -> list[PartnerScore]:
        """Return the public half of these submissions by partner, as intervals need it."""
        query = (
            sa.select(schema.partner_scores)
            .where(PARTNER_SCORE.submission.in_(submissions))
            .order_by(PARTNER_SCORE.submission, PARTNER_SCORE.version, PARTNER_SCORE.partner)
        )
        query = query if version is None else query.where(PARTNER_SCORE.version == version)
        with self.database.read() as connection:
            return [_partner_score(row) for row in connection.execute(query).mappings()]

    def board_stamp(self, version: str) -> tuple[Any, ...]:
        """Return a value that changes when the rows of a version's board may: it reads no row."""
        query = (
            sa.select(
                SUBMISSION.state,
                sa.func.count(),
                sa.func.max(SCORE.created_at),
                sa.func.count(SUBMITTER.erased_at),
            )
            .select_from(schema.scores)
            .join(schema.submissions, SUBMISSION.id == SCORE.submission)
            .join(schema.submitters, SUBMITTER.id == SUBMISSION.submitter)
            .where(SCORE.version == version, SCORE.panel == "public")
            .group_by(SUBMISSION.state)
            .order_by(SUBMISSION.state)
        )
        with self.database.read() as connection:
            return tuple(tuple(row) for row in connection.execute(query))

    def versions(self, task: str) -> list[tuple[str, dict[str, Any]]]:
        """Return (id, identity) of this task's versions: the one that is served, then the newest.

        After a rollback the newest one is not the one that is served.
        """
        query = (
            sa.select(VERSION.id, VERSION.identity)
            .where(VERSION.task == task)
            .order_by((VERSION.id == self._served(task)).desc(), VERSION.created_at.desc())
        )
        with self.database.read() as connection:
            return [(row.id, row.identity) for row in connection.execute(query)]

    def seasons(self, task: str | None = None, *, drafts: bool = False) -> list[Season]:
        """Return the seasons, the newest first; drafts are the organiser's alone to see."""
        query = sa.select(schema.seasons).where((SEASON.state != "draft") | sa.literal(drafts))
        query = query.order_by(SEASON.created_at.desc())
        query = query if task is None else query.where(SEASON.task == task)
        with self.database.read() as connection:
            return [_season(row) for row in connection.execute(query).mappings()]

    def season(self, id: str, *, drafts: bool = False) -> Season | None:
        """Return one season by its id or its name; drafts are the organiser's alone to see."""
        query = sa.select(schema.seasons).where((SEASON.id == id) | (SEASON.name == id))
        query = query.where((SEASON.state != "draft") | sa.literal(drafts))
        with self.database.read() as connection:
            row = connection.execute(query).mappings().first()
            return None if row is None else _season(row)

    def entries_met(self, season: str) -> set[str]:
        """Return the labs' declared entries that have any score in a season."""
        query = sa.select(SUBMISSION.entry).join(schema.scores, SCORE.submission == SUBMISSION.id)
        query = query.where(SUBMISSION.season == season, SUBMISSION.entry.is_not(None))
        query = query.where(SUBMISSION.kind == "file")  # those of the zoo compete with nobody
        with self.database.read() as connection:
            return set(connection.execute(query).scalars())

    def unplayed(self, season: str) -> list[str]:
        """Return the submissions that workers could not play on a season's panel B."""
        with self.database.read() as connection:
            return list(unplayed_b(connection, season))

    def is_kept(self, artefact: str) -> bool:
        """Return whether a file that was handed in is still there: it was not erased."""
        query = sa.select(ARTEFACT.sha256).where(ARTEFACT.sha256 == artefact)
        with self.database.read() as connection:
            kept_file = connection.execute(query.where(ARTEFACT.erased_at.is_(None)))
            return kept_file.first() is not None

    def attempts(self, season: str, submitter: str | None = None) -> list[Attempts]:
        """Return each submitter's attempts in a season, which the board shows.

        `submitter` is the id of the one who is asked about.
        """
        query = (
            sa.select(SUBMITTER.name, SUBMISSION.attempt, SEASON.budget, sa.func.count())
            .join(schema.submitters, SUBMITTER.id == SUBMISSION.submitter)
            .join(schema.seasons, SEASON.id == SUBMISSION.season)
            .where(SUBMISSION.season == season, SUBMISSION.kind != "reference")
            .group_by(SUBMITTER.name, SUBMISSION.attempt, SEASON.budget)
        )
        if submitter is not None:
            query = query.where(SUBMISSION.submitter == submitter)
        counts: dict[str, dict[str, int]] = {}
        with self.database.read() as connection:
            for name, attempt, budget, count in connection.execute(query):
                counts.setdefault(name, {"budget": budget})[attempt] = count
        return [
            Attempts(name, row.get("spent", 0), row.get("reserved", 0), row["budget"])
            for name, row in sorted(counts.items())
        ]

    def ledger(self, after: int = 0, limit: int = 1000) -> list[LedgerEntry]:
        """Return the entries behind number `after`, in order."""
        query = sa.select(schema.ledger).where(ENTRY.seq > after).order_by(ENTRY.seq)
        with self.database.read() as connection:
            rows = connection.execute(query.limit(limit)).mappings()
            return [LedgerEntry(**row) for row in rows]

    def people(self, task: str) -> dict[str, Any] | None:
        """Return the newest accepted figures with people of a task; None if there are none."""
        query = sa.select(ENTRY.body).where(ENTRY.kind == PEOPLE).order_by(ENTRY.seq.desc())
        with self.database.read() as connection:
            bodies = (row.body for row in connection.execute(query))
            return next((body for body in bodies if body["task"] == task), None)

    def receipt(self, submission: str) -> dict[str, Any] | None:
        """Return the newest signed receipt of a submission."""
        query = sa.select(RECEIPT.content, RECEIPT.signature).where(
            RECEIPT.submission == submission
        )
        with self.database.read() as connection:
            row = connection.execute(query.order_by(RECEIPT.created_at.desc())).first()
        return None if row is None else {"content": row.content, "signature": row.signature}


def unplayed_b(reader: Reader, season: str) -> dict[str, float]:
    """Return the submissions that workers failed on panel B, with the times of their ends."""
    query = (
        sa.select(SUBMISSION.id, sa.func.max(JOB.leased_at))
        .join(schema.jobs, JOB.submission == SUBMISSION.id)
        .where(SUBMISSION.season == season, SUBMISSION.state.in_(("scored", "failed")))
        .where(SUBMISSION.artefact.is_(None) | SUBMISSION.artefact.not_in(ERASED))
        .where(JOB.panel == "B", JOB.state == "cancelled", JOB.failures >= MAX_FAILURES)
        .group_by(SUBMISSION.id)
    )
    return {id: at for id, at in reader.execute(query)}


def _submission_query() -> sa.Select:
    name = SUBMITTER.name.label("submitter_name")
    query = sa.select(schema.submissions, name, DECLARED.files, DECLARED.card)
    query = query.join(schema.submitters, SUBMITTER.id == SUBMISSION.submitter)
    return query.outerjoin(schema.entries, DECLARED.id == SUBMISSION.entry)


def _of_method(submission: str) -> sa.ColumnElement[bool]:
    """Return whether a submission has the task, submitter and method of another."""
    keys = SUBMISSION.task, SUBMISSION.submitter, SUBMISSION.method
    other = schema.submissions.alias()
    same = sa.select(*(other.c[key.name] for key in keys)).where(other.c.id == submission)
    return sa.tuple_(*keys).in_(same)


def _score(row: Any) -> Score:
    return Score(
        submission=row.submission,
        submitter=row.submitter_name,
        task=row.task,
        method=row.method,
        panel=row.panel,
        version=row.version,
        figures=row.released,
        created_at=row.created_at,
    )


def _partner_score(row: Any) -> PartnerScore:
    fields: dict[str, Any] = {**row, "returns": tuple(row["returns"])}
    return PartnerScore(**fields)


def _season(row: Any) -> Season:
    names = [field.name for field in dataclasses.fields(Season)]
    return Season(**{name: row[name] for name in names})
