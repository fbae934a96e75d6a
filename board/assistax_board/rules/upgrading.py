"""When a server starts: plan what it lacks.

After an upgrade or a rollback every submission is planned at the version that is now served. The
rows to measure by are added: scripts and the like, and the zoo's robots as declared entries of the
zoo. These take no place, and no lab's rank depends on them. Each is played once, when no lab waits.
A robot that the registry has no more leaves the board.
"""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import sqlalchemy as sa

from assistax_base.digest import json_sha256
from assistax_board.ids import new_id
from assistax_board.problems import Problem
from assistax_board.rules import closing, entries, jobs, submissions
from assistax_board.rules.catalogue import ZooEntry, version_id
from assistax_board.rules.release_pack import check_program
from assistax_board.rules.submissions import Draft
from assistax_board.rules.tokens import find_or_add
from assistax_board.store import schema
from assistax_board.store.database import Transaction
from assistax_board.store.schema import (
    ERASED,
    JOB,
    MAX_FAILURES,
    SEASON,
    SUBMISSION,
    UNFROZEN,
    VERSION,
)
from assistax_board.vocabulary import REFERENCE

if TYPE_CHECKING:
    from assistax_board.service import Service


def adopt_version(service: "Service") -> int:
    """Plan the jobs of the current version that submissions lack; return how many lacked some.

    Unfinished jobs of other versions are dropped, since no worker of today can do them. Scores of
    other versions stay, and so does what was played: after a rollback it is not played again.

    Raises:
        Problem: A season is closing under another version, or has persons of another program;
            nothing was changed.
    """
    changed = 0
    _check_programs(service)
    for task in service.catalogue.tasks:
        _check_closing(service, task)
    for task in service.catalogue.tasks:
        with service.begin() as transaction:
            version = submissions.record_version(transaction, service.catalogue, task)
            jobs.drop_other_versions(transaction, task, version)
            turns: Counter[str] = Counter()
            for row in _lacking(transaction, task, version):
                season = closing.season_of(transaction, row["id"])
                season = season if season is not None and season.state == "open" else None
                hidden = season is not None
                if not jobs.queue_again(transaction, row["id"], version, hidden=hidden):
                    turn = {"turn": row["turn"] + turns[row["submitter"]]}
                    submissions.plan_jobs(transaction, service.catalogue, {**row, **turn}, season)
                turns[row["submitter"]] += 1
                changed += 1
    return changed


def _lacking(transaction: Transaction, task: str, version: str) -> Sequence[Any]:
    """Return the submissions of which jobs of a version are missing, or were dropped.

    Those that were never answered come first, the others in the order of their first answers.
    """
    mine = sa.select(JOB.submission).where(JOB.version == version)
    dropped = mine.where(JOB.state == "cancelled", JOB.panel != "B")
    query = sa.select(schema.submissions).where(
        SUBMISSION.task == task,
        SUBMISSION.state.in_(("queued", "running", "scored")),
        # A season's references play panel B alone.
        (SUBMISSION.kind != "reference") | SUBMISSION.season.is_(None),
        SUBMISSION.id.not_in(mine) | SUBMISSION.id.in_(dropped),
        SUBMISSION.entry.is_(None) | SUBMISSION.entry.not_in(UNFROZEN),
        # Nobody has the file of an erased lab.
        SUBMISSION.artefact.is_(None) | SUBMISSION.artefact.not_in(ERASED),
    )
    order = SUBMISSION.finished_at.is_not(None), SUBMISSION.finished_at, SUBMISSION.created_at
    query = query.order_by(*order, SUBMISSION.id)
    return transaction.execute(query).mappings().all()


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
            JOB.state.in_(jobs.OPEN)
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


def add_references(service: "Service") -> None:
    """Queue the reference rows of every board, each once, behind all other submissions.

    The zoo's robots come first, those of the tasks with several seeds before others.
    """
    with service.begin() as transaction:
        owner = find_or_add(transaction, REFERENCE, None)
    published = {task: service.catalogue.published(task) for task in service.catalogue.tasks}
    order = sorted(published, key=lambda task: -max([len(e.seeds) for e in published[task]] or [0]))
    for task in order:
        for entry in published[task]:
            _add_published(service, owner, task, entry)
    for task in order:
        methods = service.catalogue.references(task)
        for name, method in methods.items():
            request = f"{task} {name}"
            service.submit(owner, Draft(task, method, request, kind="reference", format=name))
        with service.begin() as transaction:
            _remove_others(transaction, owner, task, set(methods))


def _add_published(service: "Service", owner: str, task: str, entry: ZooEntry) -> None:
    """Declare a method of the zoo, whole, and queue its seeds."""
    with service.begin() as transaction:
        declared = _declare(transaction, owner, task, entry)
    for name in entry.seeds:
        draft = Draft(task, entry.method, f"{task} {name}", kind="reference", format=name)
        id = service.submit(owner, draft)
        with service.begin() as transaction:
            seed = sa.update(schema.submissions).where(SUBMISSION.id == id)
            transaction.execute(seed.values(entry=declared))


def _declare(transaction: Transaction, owner: str, task: str, entry: ZooEntry) -> str:
    """Return the entry of these robots, which is frozen when it is made."""
    files = sorted(entry.seeds.values())
    request = json_sha256([task, entry.method, files])
    if before := entries.known_entry(transaction, owner, request):
        return before
    row = {
        "id": new_id(),
        "submitter": owner,
        "request": request,
        "task": task,
        "method": entry.method,
        "season": None,
        "files": files,
        "card": dataclasses.asdict(entry.card),
        "created_at": transaction.now,
        "frozen_at": transaction.now,
    }
    transaction.execute(sa.insert(schema.entries).values(row))
    names = ("id", "submitter", "task", "season", "files")
    transaction.record("declare", {name: row[name] for name in names})
    return row["id"]


def _remove_others(transaction: Transaction, owner: str, task: str, names: set[str]) -> None:
    """Take robots off the board that are no reference any more."""
    query = sa.select(SUBMISSION.id).where(
        SUBMISSION.submitter == owner,
        SUBMISSION.task == task,
        SUBMISSION.kind == "reference",
        SUBMISSION.season.is_(None),
        SUBMISSION.format.not_in(names),
        SUBMISSION.state.in_(("queued", "running", "scored")),
    )
    for id in transaction.execute(query).scalars().all():
        alone = sa.update(schema.submissions).where(SUBMISSION.id == id).values(entry=None)
        transaction.execute(alone)
        submissions.withdraw(transaction, id, owner)
