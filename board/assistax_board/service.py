"""The service as one object, called by the API, the pages and the commands."""

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from assistax_board.clock import Clock, system_clock
from assistax_board.problems import Problem
from assistax_board.rules import (
    closing,
    entries,
    jobs,
    organising,
    results,
    seasons,
    submissions,
    tokens,
    upgrading,
)
from assistax_board.rules.catalogue import (
    CHUNK,
    PUBLIC_SEED,
    Catalogue,
    panel_episodes,
    version_id,
)
from assistax_board.rules.scoring import Work
from assistax_board.rules.submissions import Admitted, Draft
from assistax_board.store import notices, schema
from assistax_board.store.artefacts import Artefacts
from assistax_board.store.database import Database, Reader, Transaction
from assistax_board.store.queries import Queries, unplayed_b
from assistax_board.store.receipts import Signer
from assistax_board.store.schema import JOB, SUBMISSION

Admit = Callable[[bytes, str], Admitted]  # (file, task); raises Refusal


@dataclasses.dataclass(frozen=True)
class Service:
    """Entry point of every change to the board."""

    database: Database
    artefacts: Artefacts
    catalogue: Catalogue
    signer: Signer
    admit: Admit
    clock: Clock = system_clock

    @property
    def queries(self) -> Queries:
        """Questions whose answers are public."""
        return Queries(self.database, self.served)

    def served(self, task: str) -> str | None:
        """Return the id of the version under which a task is scored now; None if it is not."""
        return version_id(self.catalogue.identity(task)) if task in self.catalogue.tasks else None

    def begin(self) -> AbstractContextManager[Transaction]:
        """Return a transaction of the only writer, at the time of the board's clock."""
        return self.database.begin(self.clock)

    def submit(self, submitter: str, draft: Draft) -> str:
        """Take a submission in and return its id; `submitter` is an id."""
        submissions.check_draft(draft, self.catalogue)
        if known := submissions.known(self.database, submitter, draft.request):
            return known
        draft = submissions.admitted(self.admit, draft)
        with self.begin() as transaction:
            return submissions.submit(transaction, self.artefacts, self.catalogue, submitter, draft)

    def declare(self, submitter: str, declaration: entries.Declaration) -> str:
        """Declare an entry and return its id; `submitter` is an id."""
        entries.check_declaration(declaration, self.catalogue)
        with self.begin() as transaction:
            if before := entries.known_entry(transaction, submitter, declaration.request):
                return before
            if declaration.season:
                at = declaration.season, declaration.task
                season = entries.open_season(transaction, *at)
                entries.check_attempts(transaction, season, submitter, len(declaration.files))
            return entries.declare(transaction, submitter, declaration)

    def withdraw(self, submission: str, submitter: str) -> None:
        """End a submission because its submitter wants so; a scored one leaves its board."""
        with self.begin() as transaction:
            submissions.withdraw(transaction, submission, submitter)
            self._reveal(transaction, submission)

    def lease(self, worker: str, versions: Sequence[str]) -> Work | None:
        """Give a worker the next job that it can do."""
        closing.close_due(self)
        with self.begin() as transaction:
            lease, exhausted = jobs.lease_job(transaction, worker, versions)
        for submission in exhausted:
            self.fail(submission, "worker_errors")
        return None if lease is None else self._work(lease)

    def beat(self, job: str, secret: str) -> bool:
        """Extend a lease; return False if it was lost."""
        with self.begin() as transaction:
            return jobs.beat(transaction, job, secret)

    def give_back(self, job: str, secret: str) -> None:
        """Take a job back that its worker could not finish because it stops."""
        with self.begin() as transaction:
            jobs.give_back(transaction, job, secret)

    def job_failed(self, job: str, secret: str) -> None:
        """Note that a worker could not do a job; several times are too often."""
        with self.begin() as transaction:
            submission = jobs.fail_job(transaction, job, secret)
        if submission is not None:
            self.fail(submission, "worker_errors")

    def job_refused(self, job: str, secret: str, code: str) -> None:
        """End a submission whose robot a worker could not play."""
        with self.begin() as transaction:
            row = jobs.held_job(transaction, job, secret)
            if row is None:
                raise Problem("lease_lost", "this job is no longer yours; take the next")
            submissions.refuse(transaction, row.submission, code)
            jobs.cancel_jobs(transaction, row.submission, row.version)
            self._reveal(transaction, row.submission)

    def result(self, job: str, secret: str, data: bytes, seconds: float) -> bool:
        """Take a job's result; return False if it was there already."""
        with self.database.read() as connection:
            row = connection.execute(sa.select(schema.jobs).where(JOB.id == job)).first()
            if row is None:
                raise Problem("not_found", f"no job {job!r}")
            partners = self._partners(connection, row)
            preferences = self._preferences(connection, row.submission)
            episodes = panel_episodes(_task_of(connection, row.submission), row.panel)
        return results.accept(self, job, secret, data, partners, episodes, preferences, seconds)

    def create_season(self, plan: seasons.Plan, folder: Path, public: Any) -> str:
        """Make a season of a private release; see `seasons`."""
        return seasons.create_season(self, plan, folder, public)

    def open_season(self, name: str, closes_at: float | None = None) -> str:
        """Open a season until a date, and return its Merkle root."""
        with self.begin() as transaction:
            return seasons.open_season(transaction, name, closes_at)

    def enter(self, season: str, submitter: str, chosen: Sequence[str]) -> None:
        """Choose a lab's submissions for panel B; see `closing`."""
        with self.begin() as transaction:
            closing.enter(transaction, season, submitter, chosen)

    def close_season(self, name: str) -> None:
        """Close a season before its date: panel B is played, then everything is revealed."""
        with self.begin() as transaction:
            closing.close_season(transaction, name)

    def panel_b(self, season: str) -> list[tuple[str, Any]]:
        """Return the episodes of every submission on the panel B of a closed season."""
        return results.panel_b(self.database, self.artefacts, season)

    def create_token(self, scopes: Sequence[Any], **options: Any) -> str:
        """Make a token; see `tokens.create_token`."""
        with self.begin() as transaction:
            return tokens.create_token(transaction, scopes, **options)

    erase_submitter = organising.erase_submitter
    retry = organising.retry
    disqualify = organising.disqualify
    delete_draft = organising.delete_draft
    adopt_version = upgrading.adopt_version
    add_references = upgrading.add_references

    def failures(self) -> list[organising.Failure]:
        """Return the submissions of which jobs have failed, the newest first."""
        return organising.failures(self.database)

    def extend_season(self, name: str, closes_at: float) -> None:
        """Let an open season close later than was announced, or set the date of a draft."""
        with self.begin() as transaction:
            organising.extend(transaction, name, closes_at)

    def note(self, kind: str, about: str) -> None:
        """Tell the organiser something; see `notices`."""
        with self.begin() as transaction:
            notices.note(transaction, kind, about)

    def fail(self, submission: str, reason: str) -> None:
        """End a submission without a score, for a reason of `vocabulary.FAILURES`."""
        with self.begin() as transaction:
            submissions.fail(transaction, submission, reason)
            if reason == "worker_errors":
                season = closing.season_of(transaction, submission)
                on_b = season is not None and submission in unplayed_b(transaction, season.id)
                notices.note(transaction, "panel_b" if on_b else reason, submission)
            self._reveal(transaction, submission)

    def _reveal(self, transaction: Transaction, submission: str) -> None:
        """Take a closing season on whose last job was given up."""
        season = closing.season_of(transaction, submission)
        if season is not None:
            closing.take_next_step(transaction, season.id)

    def _work(self, lease: jobs.Lease) -> Work:
        with self.database.read() as connection:
            row = connection.execute(
                sa.select(schema.submissions).where(SUBMISSION.id == lease.submission)
            ).one()
            partners = self._partners(connection, lease)
            season = closing.season_of(connection, lease.submission)
            preferences = self._preferences(connection, lease.submission)
        public = lease.panel == "public"
        return Work(
            job=lease.job,
            lease=lease.secret,
            submission=row.id,
            task=row.task,
            kind=row.kind,
            format=row.format,
            artefact=row.artefact,
            release=None if public else season.release,
            version=lease.version,
            panel=lease.panel,
            chunk=lease.chunk,
            partners=partners,
            episodes=panel_episodes(row.task, lease.panel),
            seed=f"{PUBLIC_SEED:x}"
            if public
            else seasons.panel_seed(season.secret["leaves"], lease.panel),
            preferences=preferences,
        )

    def _preferences(self, reader: Reader, submission: str) -> tuple[str, ...]:
        task = _task_of(reader, submission)
        return tuple(self.catalogue.identity(task).get("preferences", ()))

    def _partners(self, reader: Reader, job: Any) -> tuple[str, ...]:
        """Return the partners of a job's chunk."""
        season = closing.season_of(reader, job.submission)
        if job.panel == "public":
            names = self.catalogue.public_panel(_task_of(reader, job.submission))
        else:
            names = seasons.panel_partners(season.secret["leaves"], job.panel)
        return tuple(names[job.chunk * CHUNK : (job.chunk + 1) * CHUNK])


def _task_of(reader: Reader, submission: str) -> str:
    query = sa.select(SUBMISSION.task).where(SUBMISSION.id == submission)
    return reader.execute(query).scalar_one()
