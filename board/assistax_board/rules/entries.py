"""Declared entries: the seeds of one method, handed in as one thing, which rank as one.

    declared -> frozen -> played
       |           `- all files are there; none of them was scored before
       `- a card, and the hash of each seed's file

Whoever sees scores first and then chooses files would take the luckiest. So an entry names its
files before the first of them is scored, and stays whole from then on. Picking at home cannot be
seen; the card asks how many seeds were trained.

Here too: the attempts of a lab in a season, one for each file.
"""

import dataclasses
import re
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from assistax_board.cards import Card, check_card
from assistax_board.ids import new_id
from assistax_board.problems import Problem
from assistax_board.rules.catalogue import Catalogue
from assistax_board.store import schema
from assistax_board.store.database import Reader, Transaction
from assistax_board.store.schema import DECLARED, SCORE, SEASON, SUBMISSION
from assistax_board.vocabulary import GONE_STATES

LEAST, MOST = 2, 10  # seeds of an entry


@dataclasses.dataclass(frozen=True)
class Declaration:
    """An entry as it is declared, before any of its files is sent."""

    task: str
    method: str
    request: str  # as of a submission
    files: tuple[str, ...]  # sha256 of each seed's file
    card: Card
    season: str | None = None  # id


def check_declaration(declaration: Declaration, catalogue: Catalogue) -> None:
    """Check the fields of a declaration.

    Raises:
        Problem: A field is not of the form.
    """
    if declaration.task not in catalogue.tasks:
        names = ", ".join(catalogue.tasks)
        raise Problem("invalid", f"task {declaration.task!r}; allowed are {names}")
    check_names(declaration.method, declaration.request)
    files = declaration.files
    if not LEAST <= len(files) <= MOST:
        raise Problem("invalid", f"{len(files)} files; an entry has {LEAST} to {MOST}, its seeds")
    if bad := [name for name in files if not re.fullmatch("[0-9a-f]{64}", name)]:
        raise Problem("invalid", f"file {bad[0][:80]!r}; give its sha256, 64 digits of 0-9 and a-f")
    if len(set(files)) < len(files):
        raise Problem("invalid", "two files are the same; each seed of an entry is another robot")
    check_card(declaration.card, len(files))


def check_names(method: str, request: str) -> None:
    """Check the texts that a submission and an entry both have.

    Raises:
        Problem: One is empty, too long or not printable.
    """
    for name, value, most in (("method", method, 80), ("request", request, 64)):
        if not 1 <= len(value) <= most or not value.isprintable():
            raise Problem("invalid", f"{name} has 1 to {most} printable characters")


def known_entry(reader: Reader, submitter: str, request: str) -> str | None:
    """Return the entry that a request declared when it came before."""
    where = DECLARED.submitter == submitter, DECLARED.request == request
    return reader.execute(sa.select(DECLARED.id).where(*where)).scalar()


def declare(transaction: Transaction, submitter: str, declaration: Declaration) -> str:
    """Record an entry and return its id.

    Raises:
        Problem: The lab has an entry of this name, or a file was scored before.
    """
    files = sorted(declaration.files)
    _check_name_is_new(transaction, submitter, declaration)
    _check_unseen(transaction, declaration.task, files)
    row = {
        "id": new_id(),
        "submitter": submitter,
        "request": declaration.request,
        "task": declaration.task,
        "method": declaration.method,
        "season": declaration.season,
        "files": files,
        "card": dataclasses.asdict(declaration.card),
        "created_at": transaction.now,
    }
    transaction.execute(sa.insert(schema.entries).values(row))
    names = ("id", "submitter", "task", "season", "files")
    transaction.record("declare", {name: row[name] for name in names})
    return row["id"]


def place_in_entry(transaction: Transaction, submitter: str, entry: str, row: Any) -> Any:
    """Return the entry that a new submission is a seed of.

    Args:
        transaction: In which the submission is recorded.
        submitter: Id of the lab.
        entry: Id of the entry.
        row: Of the submission: a mapping of its columns, `artefact` being the file's hash.

    Raises:
        Problem: There is no such entry, it takes no more files, or it did not declare this one.
    """
    found = find_entry(transaction, entry)
    if found is None or found.submitter != submitter:
        raise Problem("not_found", f"you have no entry {entry!r}; declare it first")
    others = [name for name in ("task", "method", "season") if row[name] != getattr(found, name)]
    if others:
        declared = getattr(found, others[0])
        raise Problem(
            "invalid", f"{others[0]} is {row[others[0]]!r}; entry {entry} has {declared!r}"
        )
    if row["artefact"] not in found.files:
        raise Problem("invalid", f"entry {entry} did not declare a file {row['artefact']}")
    seeds = transaction.execute(sa.select(schema.submissions).where(SUBMISSION.entry == entry))
    for seed in seeds:
        if seed.state in GONE_STATES:
            raise Problem("too_late", f"entry {entry} has ended; declare it again")
        if seed.artefact == row["artefact"]:
            raise Problem("conflict", f"entry {entry} has this file; send the others")
    return found


def freeze(transaction: Transaction, entry: Any) -> Sequence[Any]:
    """Freeze an entry whose last file has come, and return its submissions, to be played.

    An entry that lacks files stays as it is, and nothing of it is played.

    Raises:
        Problem: One of its files was scored in the meantime.
    """
    query = sa.select(schema.submissions).where(SUBMISSION.entry == entry.id)
    seeds = transaction.execute(query.order_by(SUBMISSION.artefact)).mappings().all()
    if len(seeds) < len(entry.files):
        return ()
    _check_unseen(transaction, entry.task, entry.files)
    mine = sa.update(schema.entries).where(DECLARED.id == entry.id)
    transaction.execute(mine.values(frozen_at=transaction.now))
    return seeds


def find_entry(reader: Reader, id: str) -> Any:
    """Return an entry's row, or None if there is no such entry."""
    return reader.execute(sa.select(schema.entries).where(DECLARED.id == id)).first()


def seeds_of(reader: Reader, entry: str) -> list[str]:
    """Return the submissions of an entry.

    Raises:
        Problem: One has a score: from then on nothing leaves the entry.
    """
    ids = list(reader.execute(sa.select(SUBMISSION.id).where(SUBMISSION.entry == entry)).scalars())
    if reader.execute(sa.select(SCORE.submission).where(SCORE.submission.in_(ids))).first():
        raise Problem(
            "too_late",
            f"entry {entry} has a score, and a declared entry stays whole from its first score on; "
            "ask the organiser if it must go",
        )
    return ids


def _check_name_is_new(transaction: Transaction, submitter: str, declaration: Declaration) -> None:
    """Refuse a second entry of one name: an entry gets no more seeds when its scores are known."""
    same = sa.select(DECLARED.id).where(
        DECLARED.submitter == submitter,
        DECLARED.task == declaration.task,
        DECLARED.method == declaration.method,
        DECLARED.season.is_(None)
        if not declaration.season
        else DECLARED.season == declaration.season,
        DECLARED.frozen_at.is_not(None),
    )
    if before := transaction.execute(same.limit(1)).scalar():
        raise Problem(
            "conflict",
            f"you have an entry {declaration.method!r} ({before}), which is frozen; give this one "
            "another name",
        )


def _check_unseen(transaction: Transaction, task: str, files: Sequence[str]) -> None:
    """Refuse files that were scored: they may have been picked. The same whole entry was not."""
    query = (
        sa.select(SUBMISSION.artefact, SUBMISSION.created_at, DECLARED.files)
        .join(schema.scores, SCORE.submission == SUBMISSION.id)
        .outerjoin(schema.entries, DECLARED.id == SUBMISSION.entry)
        .where(SUBMISSION.task == task, SUBMISSION.artefact.in_(files))
        .distinct()
    )
    for row in transaction.execute(query):
        if row.files != list(files):
            raise Problem(
                "conflict",
                f"the file with sha256 {row.artefact} was scored before; a declared entry consists "
                "of robots that had no score when it was declared. Declare other seeds, or hand "
                "them in as single robots",
            )


def open_season(transaction: Transaction, id: str, task: str) -> Any:
    """Return the row of a season that takes submissions now.

    Raises:
        Problem: There is none of this id and task, or it takes none.
    """
    row = transaction.execute(sa.select(schema.seasons).where(SEASON.id == id)).first()
    if row is None or row.task != task:
        raise Problem("not_found", f"no season {id!r} of task {task}")
    if row.state != "open":
        raise Problem("too_late", f"season {row.name} is {row.state}; it must be open")
    if row.closes_at is not None and row.closes_at <= transaction.now:
        raise Problem("too_late", f"the closing date of season {row.name} has passed")
    return row


def attempts_left(transaction: Transaction, season: Any, submitter: str) -> int:
    """Count attempts anew each time: a counter could be lost between two transactions."""
    query = sa.select(sa.func.count()).where(
        SUBMISSION.season == season.id,
        SUBMISSION.submitter == submitter,
        SUBMISSION.attempt.in_(("reserved", "spent")),
    )
    return max(0, season.budget - transaction.execute(query).scalar_one())


def check_attempts(transaction: Transaction, season: Any, submitter: str, needed: int = 1) -> None:
    """Refuse files of a lab that is out of a season, or has too few attempts left in it.

    Raises:
        Problem: Why the season takes them not.
    """
    _check_not_disqualified(transaction, season, submitter)
    if (left := attempts_left(transaction, season, submitter)) < needed:
        raise Problem(
            "budget_spent",
            f"{left} of {season.budget} attempts of season {season.name} are left and {needed} "
            "needed, one for each file; submit without a season to be scored on public partners",
        )


def _check_not_disqualified(transaction: Transaction, season: Any, submitter: str) -> None:
    out = SUBMISSION.submitter == submitter, SUBMISSION.reason == "disqualified"
    query = sa.select(SUBMISSION.id).where(SUBMISSION.season == season.id, *out)
    if transaction.execute(query.limit(1)).first():
        raise Problem("not_allowed", f"the organiser disqualified you from season {season.name}")
