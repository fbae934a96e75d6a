"""The service as one object: what the API, the pages and the commands call."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from assistax_board.clock import Clock, system_clock
from assistax_board.problems import Problem
from assistax_board.rules import (
    closing,
    jobs,
    organising,
    results,
    seasons,
    submissions,
    tokens,
    upgrading,
)
from assistax_board.rules.catalogue import CHUNK, PUBLIC_SEED, Catalogue, panel_episodes
from assistax_board.rules.scoring import Work
from assistax_board.rules.submissions import Admitted, Draft
from assistax_board.store import notices, schema
from assistax_board.store.artefacts import Artefacts
from assistax_board.store.database import Database
from assistax_board.store.queries import Queries, unplayed_b
from assistax_board.store.receipts import Signer
from assistax_board.store.schema import JOB, SUBMISSION
from assistax_board.vocabulary import REFERENCE

Admit = Callable[[bytes, str], Admitted]  # (file, task); raises Refusal


@dataclasses.dataclass(frozen=True)
class Service:
    """Everything that happens, happens through here."""

    database: Database
    artefacts: Artefacts
    catalogue: Catalogue
    signer: Signer
    admit: Admit
    clock: Clock = system_clock

    @property
    def queries(self) -> Queries:
        """What may be shown to anybody."""
        return Queries(self.database)

    def submit(self, submitter: str, draft: Draft) -> str:
        """Take a submission in and return its id; `submitter` is an id."""
        submissions.check_draft(draft, self.catalogue)
        if known := submissions.known(self.database, submitter, draft.request):
            return known
        draft = submissions.admitted(self.admit, draft)
        return submissions.submit(
            self.database, self.artefacts, self.catalogue, submitter, draft, self.clock()
        )

    def withdraw(self, submission: str, submitter: str) -> None:
        """End a submission because its submitter wants so; a scored one leaves its board."""
        submissions.withdraw(self.database, submission, submitter, self.clock())
        with self.database.write() as connection:
            self._reveal(connection, submission)

    def lease(self, worker: str, versions: Sequence[str]) -> Work | None:
        """Give a worker the next job that it can do."""
        closing.close_due(self.database, self.clock())
        lease, exhausted = jobs.lease_job(self.database, worker, versions, self.clock())
        for submission in exhausted:
            self.fail(submission, "worker_errors")
        return None if lease is None else self._work(lease)

    def beat(self, job: str, secret: str) -> bool:
        """Extend a lease; False where it was lost."""
        return jobs.beat(self.database, job, secret, self.clock())

    def give_back(self, job: str, secret: str) -> None:
        """Take a job back that its worker could not finish because it stops."""
        jobs.give_back(self.database, job, secret)

    def job_failed(self, job: str, secret: str) -> None:
        """Note that a worker could not do a job; several times are too often."""
        if submission := jobs.fail_job(self.database, job, secret):
            self.fail(submission, "worker_errors")

    def job_refused(self, job: str, secret: str, code: str) -> None:
        """End a submission whose robot a worker could not play."""
        with self.database.write() as connection:
            row = jobs.held_job(connection, job, secret)
            if row is None:
                raise Problem("lease_lost", "this job is no longer yours; take the next")
            submissions.refuse(connection, row.submission, code, self.clock())
            jobs.cancel_jobs(connection, row.submission, row.version)
            self._reveal(connection, row.submission)

    def result(self, job: str, secret: str, data: bytes, seconds: float) -> bool:
        """Take a job's result; False where it was there already."""
        with self.database.read() as connection:
            row = connection.execute(sa.select(schema.jobs).where(JOB.id == job)).first()
            if row is None:
                raise Problem("not_found", f"no job {job!r}")
            partners = self._partners(connection, row)
            preferences = self._preferences(connection, row.submission)
            episodes = panel_episodes(_task_of(connection, row.submission), row.panel)
        store = results.ResultStore(self.database, self.artefacts, self.signer)
        return results.accept(
            store, job, secret, data, partners, episodes, preferences, seconds, self.clock()
        )

    def create_season(self, plan: seasons.Plan, folder: Path, public: Any) -> str:
        """Make a season of a private release; see `seasons`."""
        return seasons.create_season(
            self.database, self.artefacts, plan, folder, public, self.clock()
        )

    def open_season(self, name: str, closes_at: float | None = None) -> str:
        """Open a season until a date, and return its Merkle root."""
        return seasons.open_season(self.database, name, self.clock(), closes_at)

    def enter(self, season: str, submitter: str, chosen: Sequence[str]) -> None:
        """Choose what a lab plays panel B with; see `closing`."""
        closing.enter(self.database, season, submitter, chosen, self.clock())

    def close_season(self, name: str) -> None:
        """Close a season before its date: panel B is played, then everything is revealed."""
        closing.close_season(self.database, name, self.clock())

    def panel_b(self, season: str) -> list[tuple[str, Any]]:
        """Return the episodes of every submission on the panel B of a closed season."""
        return results.panel_b(self.database, self.artefacts, season)

    def create_token(self, scopes: Sequence[Any], **options: Any) -> str:
        """Make a token; see `tokens.create_token`."""
        return tokens.create_token(self.database, self.clock(), scopes, **options)

    erase_submitter = organising.erase_submitter
    retry = organising.retry
    disqualify = organising.disqualify
    adopt_version = upgrading.adopt_version

    def failures(self) -> list[organising.Failure]:
        """Return the submissions of which jobs have failed, the newest first."""
        return organising.failures(self.database)

    def extend_season(self, name: str, closes_at: float) -> None:
        """Let an open season close later than was announced."""
        organising.extend(self.database, name, closes_at, self.clock())

    def note(self, kind: str, about: str) -> None:
        """Tell the organiser something; see `notices`."""
        with self.database.write() as connection:
            notices.note(connection, kind, about, self.clock())

    def add_references(self) -> None:
        """Queue what every board measures by, each once, to be played when nobody else waits."""
        with self.database.write() as connection:
            nobody = tokens.find_or_add(connection, REFERENCE, None, self.clock())
        for task in self.catalogue.tasks:
            for name, method in self.catalogue.references(task).items():
                request = f"{task} {name}"
                self.submit(nobody, Draft(task, method, request, kind="reference", format=name))

    def fail(self, submission: str, reason: str) -> None:
        """End a submission without a score, for a reason of `vocabulary.FAILURES`."""
        now = self.clock()
        with self.database.write() as connection:
            submissions.fail(connection, submission, reason, now)
            if reason == "worker_errors":
                season = closing.season_of(connection, submission)
                on_b = season is not None and submission in unplayed_b(connection, season.id)
                notices.note(connection, "panel_b" if on_b else reason, submission, now)
            self._reveal(connection, submission)

    def _reveal(self, connection: sa.Connection, submission: str) -> None:
        """Take a closing season on whose last job was given up."""
        season = closing.season_of(connection, submission)
        if season is not None:
            closing.go_on(connection, season.id, self.clock())

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

    def _preferences(self, connection: sa.Connection, submission: str) -> tuple[str, ...]:
        task = _task_of(connection, submission)
        return tuple(self.catalogue.identity(task).get("preferences", ()))

    def _partners(self, connection: sa.Connection, job: Any) -> tuple[str, ...]:
        """Return the partners of a job's chunk."""
        season = closing.season_of(connection, job.submission)
        if job.panel == "public":
            names = self.catalogue.public_panel(_task_of(connection, job.submission))
        else:
            names = seasons.panel_partners(season.secret["leaves"], job.panel)
        return tuple(names[job.chunk * CHUNK : (job.chunk + 1) * CHUNK])


def _task_of(connection: sa.Connection, submission: str) -> str:
    query = sa.select(SUBMISSION.task).where(SUBMISSION.id == submission)
    return connection.execute(query).scalar_one()
