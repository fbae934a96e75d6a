"""What pages and the API may ask the database, and nothing else.

Every answer is safe to show to anybody: of hidden panels it holds what was released, never more.
Nothing here imports JAX or plays an episode.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from assistax_board.store import schema as t
from assistax_board.store.database import Database
from assistax_board.vocabulary import (
    FINAL_STATES,
    REASONS,
    AttemptState,
    Kind,
    SeasonState,
    SubmissionState,
)

STATEMENT = (
    "The partners are trained policies in simulation. They are not validated models of people: "
    "a place on this board says nothing about safety or benefit for a person."
)
DEFAULT_JOB_SECONDS = 20.0  # of a job, before any was timed


@dataclasses.dataclass(frozen=True)
class Submission:
    """One robot that was handed in."""

    id: str
    submitter: str  # name, or "erased"
    task: str
    method: str  # submissions of one submitter and method are seeds of one method
    kind: Kind
    season: str | None
    state: SubmissionState
    reason: str | None  # word of `vocabulary.REASONS`
    reason_text: str | None
    attempt: AttemptState
    created_at: float
    finished_at: float | None
    artefact: str | None  # sha256 of the file
    licence: str
    place: int | None  # in the queue, 1 is next; None once it ended
    eta_seconds: float | None
    jobs_done: int
    jobs: int
    entered: bool  # chosen for panel B of its season


@dataclasses.dataclass(frozen=True)
class Score:
    """What may be shown of one panel for one submission."""

    submission: str
    submitter: str
    task: str
    method: str
    panel: str  # "public", "A" or "B"
    version: str
    figures: dict[str, Any]  # mean, mean_ci, iqm, iqm_ci, n; of A and B as it was released
    created_at: float


@dataclasses.dataclass(frozen=True)
class PartnerScore:
    """Returns of a submission with one public partner."""

    submission: str
    version: str
    partner: str
    algorithm: str
    disability: str
    returns: tuple[float, ...]  # [K]
    successes: int


@dataclasses.dataclass(frozen=True)
class Season:
    """A private release and its rules; nothing secret."""

    id: str
    name: str
    task: str
    state: SeasonState
    budget: int
    rules: str
    root: str | None
    panel_sizes: dict[str, int]
    opened_at: float | None
    closes_at: float | None  # by itself
    closed_at: float | None


@dataclasses.dataclass(frozen=True)
class Attempts:
    """A submitter's attempts in a season."""

    submitter: str
    spent: int
    reserved: int
    budget: int

    @property
    def left(self) -> int:
        """How many may still be made."""
        return max(0, self.budget - self.spent - self.reserved)


@dataclasses.dataclass(frozen=True)
class LedgerEntry:
    """One entry of the ledger; `hash` covers the rest and the entry before."""

    seq: int
    at: float
    kind: str
    body: dict[str, Any]
    previous: str
    hash: str


class Queries:
    """The questions that pages and the API may ask."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def submissions(
        self,
        *,
        task: str | None = None,
        submitter: str | None = None,
        season: str | None = None,
        limit: int = 100,
    ) -> list[Submission]:
        """Return the newest submissions first; `submitter` is an id."""
        c = t.submissions.c
        query = _submission_query().order_by(c.created_at.desc(), c.id).limit(limit)
        for column, value in ((c.task, task), (c.submitter, submitter), (c.season, season)):
            query = query if value is None else query.where(column == value)
        with self._database.read() as connection:
            queue = _Queue(connection)
            return [queue.describe(row) for row in connection.execute(query)]

    def submission(self, id: str) -> Submission | None:
        """Return one submission, if there is one of this id."""
        with self._database.read() as connection:
            row = connection.execute(_submission_query().where(t.submissions.c.id == id)).first()
            return None if row is None else _Queue(connection).describe(row)

    def state(self, id: str) -> SubmissionState | None:
        """Return the state of a submission alone: cheap enough to be asked every second."""
        c = t.submissions.c
        with self._database.read() as connection:
            return connection.execute(sa.select(c.state).where(c.id == id)).scalar()

    def scores(
        self,
        *,
        task: str | None = None,
        submission: str | None = None,
        panel: str | None = None,
        season: str | None = None,
        version: str | None = None,
    ) -> list[Score]:
        """Return released scores, the oldest first; `version` is an id, see `versions`."""
        s, r = t.scores.c, t.submissions.c
        query = (
            sa.select(t.scores, r.task, r.method, t.submitters.c.name.label("submitter_name"))
            .join(t.submissions, r.id == s.submission)
            .join(t.submitters, t.submitters.c.id == r.submitter)
            .where(s.released.is_not(None))
            .order_by(s.created_at, s.submission)
        )
        if submission is None:  # off every board; its own page still tells
            query = query.where((r.state != "retracted") | (s.panel == "B"))
        wanted = (
            (r.task, task),
            (s.submission, submission),
            (s.panel, panel),
            (r.season, season),
            (s.version, version),
        )
        for column, value in wanted:
            query = query if value is None else query.where(column == value)
        with self._database.read() as connection:
            return [_score(row) for row in connection.execute(query)]

    def partner_scores(
        self, submissions: Sequence[str], version: str | None = None
    ) -> list[PartnerScore]:
        """Return the public half of these submissions, partner by partner: what intervals need."""
        c = t.partner_scores.c
        query = (
            sa.select(t.partner_scores)
            .where(c.submission.in_(submissions))
            .order_by(c.submission, c.version, c.partner)
        )
        query = query if version is None else query.where(c.version == version)
        with self._database.read() as connection:
            rows = connection.execute(query).mappings()
            return [_partner_score(row) for row in rows]

    def versions(self, task: str) -> list[tuple[str, dict[str, Any]]]:
        """Return (id, identity) of what scored this task; the first is the newest, the board's."""
        c = t.versions.c
        query = sa.select(c.id, c.identity).where(c.task == task).order_by(c.created_at.desc())
        with self._database.read() as connection:
            return [(row.id, row.identity) for row in connection.execute(query)]

    def seasons(self, task: str | None = None) -> list[Season]:
        """Return the seasons, the newest first."""
        query = sa.select(t.seasons).order_by(t.seasons.c.created_at.desc())
        query = query if task is None else query.where(t.seasons.c.task == task)
        with self._database.read() as connection:
            return [_season(row) for row in connection.execute(query).mappings()]

    def season(self, id: str) -> Season | None:
        """Return one season by its id or its name."""
        c = t.seasons.c
        with self._database.read() as connection:
            query = sa.select(t.seasons).where((c.id == id) | (c.name == id))
            row = connection.execute(query).mappings().first()
            return None if row is None else _season(row)

    def attempts(self, season: str) -> list[Attempts]:
        """Return who has made how many attempts in a season: they stand on the board."""
        c = t.submissions.c
        query = (
            sa.select(t.submitters.c.name, c.attempt, t.seasons.c.budget, sa.func.count())
            .join(t.submitters, t.submitters.c.id == c.submitter)
            .join(t.seasons, t.seasons.c.id == c.season)
            .where(c.season == season, c.kind != "reference")
            .group_by(t.submitters.c.name, c.attempt, t.seasons.c.budget)
        )
        found: dict[str, dict[str, int]] = {}
        with self._database.read() as connection:
            for name, attempt, budget, count in connection.execute(query):
                found.setdefault(name, {"budget": budget})[attempt] = count
        return [
            Attempts(name, row.get("spent", 0), row.get("reserved", 0), row["budget"])
            for name, row in sorted(found.items())
        ]

    def ledger(self, after: int = 0, limit: int = 1000) -> list[LedgerEntry]:
        """Return the entries behind number `after`, in order."""
        query = sa.select(t.ledger).where(t.ledger.c.seq > after).order_by(t.ledger.c.seq)
        with self._database.read() as connection:
            rows = connection.execute(query.limit(limit)).mappings()
            return [LedgerEntry(**row) for row in rows]

    def receipt(self, submission: str) -> dict[str, Any] | None:
        """Return the newest signed receipt of a submission."""
        c = t.receipts.c
        query = sa.select(c.content, c.signature).where(c.submission == submission)
        with self._database.read() as connection:
            row = connection.execute(query.order_by(c.created_at.desc())).first()
        return None if row is None else {"content": row.content, "signature": row.signature}


class _Queue:
    """The queue as one transaction sees it: who is before whom, and how long that takes."""

    def __init__(self, connection: sa.Connection) -> None:
        c = t.jobs.c
        counts = sa.select(c.submission, c.state, sa.func.count()).group_by(c.submission, c.state)
        self._jobs: dict[str, dict[str, int]] = {}
        for submission, state, count in connection.execute(counts):
            self._jobs.setdefault(submission, {})[state] = count
        s = t.submissions.c
        waiting = sa.select(s.id).where(s.state.not_in(FINAL_STATES))
        order = waiting.order_by(s.turn, s.created_at, s.id)
        self._order = [row.id for row in connection.execute(order)]
        recent = sa.select(t.results.c.seconds).order_by(t.results.c.created_at.desc()).limit(50)
        seconds = [row.seconds for row in connection.execute(recent)]
        self._job_seconds = sum(seconds) / len(seconds) if seconds else DEFAULT_JOB_SECONDS
        leased = sa.select(sa.func.count(sa.distinct(c.worker))).where(c.state == "leased")
        self._workers = max(1, connection.execute(leased).scalar_one())

    def describe(self, row: Any) -> Submission:
        """Return a submission with its place and the time left."""
        jobs = self._jobs.get(row.id, {})
        live = {name: count for name, count in jobs.items() if name != "cancelled"}
        place = eta = None
        if row.id in self._order:
            place = self._order.index(row.id) + 1
            eta = sum(map(self._left, self._order[:place])) * self._job_seconds / self._workers
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
        )

    def _left(self, submission: str) -> int:
        jobs = self._jobs.get(submission, {})
        return jobs.get("waiting", 0) + jobs.get("leased", 0)


def _submission_query() -> sa.Select:
    name = t.submitters.c.name.label("submitter_name")
    return sa.select(t.submissions, name).join(
        t.submitters, t.submitters.c.id == t.submissions.c.submitter
    )


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
