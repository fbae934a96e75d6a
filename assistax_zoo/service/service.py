"""The service as one object: what the API, the pages and the commands call."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import sqlalchemy as sa

from assistax_zoo.service import jobs, ledger, results, seasons, submissions, tokens
from assistax_zoo.service import schema as t
from assistax_zoo.service.artefacts import Artefacts
from assistax_zoo.service.catalogue import (
    CHUNK,
    EPISODES,
    HIDDEN_EPISODES,
    PUBLIC_SEED,
    Catalogue,
    version_id,
)
from assistax_zoo.service.clock import Clock, system_clock
from assistax_zoo.service.database import Database
from assistax_zoo.service.live.rooms import GONE_SECONDS, LIFE_SECONDS, Rooms
from assistax_zoo.service.problems import Problem
from assistax_zoo.service.queries import Queries
from assistax_zoo.service.receipts import Signer
from assistax_zoo.service.scoring import Work
from assistax_zoo.service.submissions import Draft
from assistax_zoo.service.vocabulary import FINAL_STATES, REFERENCE

Admit = Callable[[bytes, str], str]  # (file, task) -> format; raises Refusal


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
        args = self.database, self.artefacts, self.catalogue, submitter, draft
        return submissions.submit(*args, self.clock())

    def withdraw(self, submission: str, submitter: str) -> None:
        """End a submission because its submitter wants so."""
        submissions.withdraw(self.database, submission, submitter, self.clock())

    def lease(
        self, worker: str, versions: Sequence[str], rooms: Rooms | None = None
    ) -> Work | None:
        """Give a worker the next job that it can do; `rooms` say which live clients are there."""
        connected = () if rooms is None else rooms.connected()
        if rooms is not None:
            self._end_absent(rooms)
        lease, exhausted = jobs.lease_job(self.database, worker, versions, self.clock(), connected)
        for submission in exhausted:
            self._fail(submission, "worker_errors")
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
            self._fail(submission, "worker_errors")

    def job_refused(self, job: str, secret: str, code: str) -> None:
        """End a submission whose robot a worker could not play."""
        with self.database.write() as connection:
            row = jobs.held_job(connection, job, secret)
            if row is None:
                raise Problem("lease_lost", "this job is no longer yours; take the next")
            submissions.refuse(self.database, connection, row.submission, code, self.clock())
            jobs.cancel_jobs(connection, row.submission, row.version)
            self._reveal(connection, row.submission)

    def result(self, job: str, secret: str, data: bytes, seconds: float) -> bool:
        """Take a job's result; False where it was there already."""
        with self.database.read() as connection:
            row = connection.execute(sa.select(t.jobs).where(t.jobs.c.id == job)).first()
            if row is None:
                raise Problem("not_found", f"no job {job!r}")
            partners = self._partners(connection, row)
            preferences = self._preferences(connection, row.submission)
        desk = results.Desk(self.database, self.artefacts, self.signer)
        given = data, partners, preferences, seconds
        return results.accept(desk, job, secret, *given, self.clock())

    def owns_live(self, submission: str, submitter: str | None) -> bool:
        """Return whether a live submission that has not ended is this lab's."""
        s = t.submissions.c
        where = s.id == submission, s.submitter == submitter, s.kind == "live"
        with self.database.read() as connection:
            query = sa.select(s.id).where(*where, s.state.not_in(FINAL_STATES))
            return connection.execute(query).first() is not None

    def live_submission(self, job: str, secret: str) -> str:
        """Return the live submission of a job that this lease holds."""
        with self.database.read() as connection:
            row = jobs.held_job(connection, job, secret)
        if row is None or row.state != "leased":
            raise Problem("lease_lost", "this job is no longer yours; take the next")
        return row.submission

    def live_away(self, job: str, secret: str) -> None:
        """Take back a job whose client is away, unless it is with hidden partners.

        Playing those again from the start would show the robot the same episodes twice.
        """
        with self.database.read() as connection:
            row = jobs.held_job(connection, job, secret)
        if row is not None and row.panel == "public":
            jobs.give_back(self.database, job, secret)
        elif row is not None:
            self._fail(row.submission, "client_gone")

    def live_failed(self, submission: str, reason: str) -> None:
        """End a live submission for a reason of `vocabulary.FAILURES`."""
        self._fail(submission, reason)

    def live_refused(self, submission: str, code: str) -> None:
        """End a live submission whose robot gave a wrong answer."""
        with self.database.write() as connection:
            submissions.refuse(self.database, connection, submission, code, self.clock())

    def create_season(self, plan: seasons.Plan, folder: Path, public: Any) -> str:
        """Make a season of a private release; see `seasons`."""
        args = self.database, self.artefacts, plan, folder, public
        return seasons.create_season(*args, self.clock())

    def open_season(self, name: str) -> str:
        """Open a season and return its Merkle root."""
        return seasons.open_season(self.database, name, self.clock())

    def close_season(self, name: str) -> None:
        """Close a season: panel B is played, then everything is revealed."""
        seasons.close_season(self.database, name, self.clock())

    def create_token(self, scopes: Sequence[Any], **options: Any) -> str:
        """Make a token; see `tokens.create_token`."""
        return tokens.create_token(self.database, self.clock(), scopes, **options)

    def erase_submitter(self, submitter: str) -> None:
        """Remove a lab's name, contact and files; hashes and scores stay, under a pseudonym."""
        erase_submitter(self, submitter)

    def add_references(self) -> None:
        """Queue what every board measures by, each once, to be played when nobody else waits."""
        with self.database.write() as connection:
            nobody = tokens.find_or_add(connection, REFERENCE, None, self.clock())
        for task in self.catalogue.tasks:
            for name, method in self.catalogue.references(task).items():
                request = f"{task} {name}"
                self.submit(nobody, Draft(task, method, request, kind="reference", format=name))

    def adopt_version(self) -> int:
        """Score anew what was scored by other versions; return how many submissions that is."""
        return adopt_version(self)

    def _end_absent(self, rooms: Rooms) -> None:
        """End live submissions whose clients have not come for too long."""
        s = t.submissions.c
        live = sa.select(s.id, s.created_at).where(s.kind == "live")
        with self.database.read() as connection:
            waiting = connection.execute(live.where(s.state.not_in(FINAL_STATES))).all()
        for row in waiting:
            is_old = self.clock() - row.created_at > LIFE_SECONDS
            if is_old or rooms.away_for(row.id) > GONE_SECONDS:
                self._fail(row.id, "client_gone")

    def _fail(self, submission: str, reason: str) -> None:
        with self.database.write() as connection:
            submissions.fail(self.database, connection, submission, reason, self.clock())
            self._reveal(connection, submission)

    def _reveal(self, connection: sa.Connection, submission: str) -> None:
        """Reveal a closing season whose last job was given up."""
        season = _season_of(connection, submission)
        if season is not None:
            seasons.reveal_if_done(self.database, connection, season.id, self.clock())

    def _work(self, lease: jobs.Lease) -> Work:
        with self.database.read() as connection:
            s = t.submissions.c
            row = connection.execute(sa.select(t.submissions).where(s.id == lease.submission)).one()
            partners = self._partners(connection, lease)
            season = _season_of(connection, lease.submission)
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
            episodes=EPISODES if public else HIDDEN_EPISODES,
            seed=f"{PUBLIC_SEED:x}"
            if public
            else seasons.panel_seed(season.secret["leaves"], lease.panel),
            preferences=preferences,
        )

    def _preferences(self, connection: sa.Connection, submission: str) -> tuple[str, ...]:
        s = t.submissions.c
        task = connection.execute(sa.select(s.task).where(s.id == submission)).scalar_one()
        return tuple(self.catalogue.identity(task).get("preferences", ()))

    def _partners(self, connection: sa.Connection, job: Any) -> tuple[str, ...]:
        """Return the partners of a job's chunk."""
        season = _season_of(connection, job.submission)
        if job.panel == "public":
            s = t.submissions.c
            task = connection.execute(sa.select(s.task).where(s.id == job.submission)).scalar_one()
            names = [partner.id for partner in self.catalogue.public_panel(task)]
        else:
            names = seasons.panel_partners(season.secret["leaves"], job.panel)
        return tuple(names[job.chunk * CHUNK : (job.chunk + 1) * CHUNK])


def erase_submitter(service: Service, submitter: str) -> None:
    """Remove a person's data; the ledger holds ids and hashes alone, so its chain stays whole."""
    now, s = service.clock(), t.submissions.c
    with service.database.write() as connection:
        where = t.submitters.c.id == submitter
        row = connection.execute(sa.select(t.submitters).where(where)).first()
        if row is None:
            raise Problem("not_found", f"no submitter {submitter!r}")
        values = {"name": f"erased-{submitter}", "contact": None, "erased_at": now}
        connection.execute(sa.update(t.submitters).where(where).values(values))
        open_tokens = sa.update(t.tokens).where(t.tokens.c.submitter == submitter)
        connection.execute(open_tokens.values(revoked_at=now, label="erased"))
        mine = connection.execute(sa.select(s.id, s.artefact).where(s.submitter == submitter)).all()
        for each in mine:
            submissions.fail(service.database, connection, each.id, "withdrawn", now)
            update = sa.update(t.submissions).where(s.id == each.id)
            # Its client chose the request, and may have written anything.
            connection.execute(update.values(method="erased", request=each.id))
            _sign_anew(service, connection, each.id)
        others = sa.select(s.artefact).where(s.submitter != submitter, s.artefact.is_not(None))
        kept = set(connection.execute(others).scalars())
        gone = {each.artefact for each in mine if each.artefact} - kept
        a = t.artefacts.c
        erased = sa.update(t.artefacts).where(a.sha256.in_(gone)).values(erased_at=now)
        connection.execute(erased)
        ledger.append(service.database, connection, now, "erase", {"submitter": submitter})
    for name in gone:
        service.artefacts.erase(name)


def _sign_anew(service: Service, connection: sa.Connection, submission: str) -> None:
    """Sign receipts without the method's name: the same score, at the same place of the ledger."""
    r = t.receipts.c
    query = sa.select(r.version, r.content).where(r.submission == submission)
    for row in connection.execute(query).all():
        content = row.content | {"method": "erased"}
        mine = sa.update(t.receipts).where(r.submission == submission, r.version == row.version)
        connection.execute(mine.values(content=content, signature=service.signer.sign(content)))


def adopt_version(service: Service) -> int:
    """Cut everything into jobs of the current version that has none: after an upgrade.

    Unfinished jobs of older versions are dropped, since no worker of today can do them. Scores of
    older versions stay.

    Raises:
        Problem: A season is closing under another version; nothing was changed.
    """
    now, s, changed = service.clock(), t.submissions.c, 0
    for task in service.catalogue.tasks:
        _check_closing(service, task)
    for task in service.catalogue.tasks:
        version = version_id(service.catalogue.identity(task))
        with service.database.write() as connection:
            planned = sa.select(t.jobs.c.submission).where(t.jobs.c.version == version)
            stale = sa.select(t.submissions).where(
                s.task == task,
                s.state.in_(("queued", "running", "scored")),
                s.kind.in_(("file", "reference")),
                s.id.not_in(planned),
            )
            for row in connection.execute(stale).mappings().all():
                jobs.cancel_jobs(connection, row["id"])
                season = _season_of(connection, row["id"])
                season = season if season is not None and season.state == "open" else None
                submissions.plan_jobs(connection, service.catalogue, row, season, now)
                changed += 1
    return changed


def _check_closing(service: Service, task: str) -> None:
    """Refuse another version while panel B of a season is played: it is played once, by one."""
    identity = service.catalogue.identity(task)
    j, s, v = t.jobs.c, t.submissions.c, t.versions.c
    query = (
        sa.select(t.seasons.c.name, v.identity)
        .join(t.submissions, s.season == t.seasons.c.id)
        .join(t.jobs, j.submission == s.id)
        .join(t.versions, v.id == j.version)
        .where(s.task == task, j.panel == "B", j.state.in_(("waiting", "leased")))
        .where(j.version != version_id(identity))
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
            f"season {row.name} is closing, and one version alone plays its last panel "
            f"({differences}); start the version and options that it began with until it is closed",
        )


def _season_of(connection: sa.Connection, submission: str) -> Any:
    """Return the season of a submission, secrets included: never to be shown."""
    s = t.submissions.c
    query = sa.select(t.seasons).join(t.submissions, s.season == t.seasons.c.id)
    return connection.execute(query.where(s.id == submission)).first()
