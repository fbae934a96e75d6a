"""The life of a submission, from its arrival to its end: scored, refused, or failed.

    queued -> running -> scored
       |         |-----> failed    (a word of FAILURES; the attempt is refunded or spent)
       `-> refused                 (a word of REFUSALS; costs nothing)

A scored single robot may be retracted by its submitter: it leaves its board, what was said of it
stays. A seed of a declared entry ends with the whole entry, or not at all; see `entries`.

Everything that happens at once to a submission happens in one transaction, with its ledger entry.
"""

import dataclasses
from typing import Any, NamedTuple

import sqlalchemy as sa

from assistax_base.digest import sha256
from assistax_board.cards import LINK
from assistax_board.ids import new_id
from assistax_board.problems import Problem, Refusal
from assistax_board.rules import entries, jobs
from assistax_board.rules.catalogue import CHUNK, Catalogue, version_id
from assistax_board.rules.scoring import cut
from assistax_board.store import schema
from assistax_board.store.artefacts import Artefacts, record_artefact
from assistax_board.store.database import Database, Reader, Transaction
from assistax_board.store.notices import note
from assistax_board.store.played import warning_of
from assistax_board.store.schema import JOB, SEASON, SUBMISSION, SUBMITTER
from assistax_board.vocabulary import FINAL_STATES, OWN_FAILURES, Kind

MAX_BYTES = 16 * 1024 * 1024
LAST = 1_000_000  # turn of the references: they are played when nobody else waits
LICENCES = ("Apache-2.0", "MIT", "BSD-3-Clause", "CC-BY-4.0", "CC0-1.0", "evaluation-only")

# What a submitter may say of a method, and in how many characters.
DESCRIPTION = {"about": 600, "link": 200, "citation": 1000}


class Admitted(NamedTuple):
    """Result of a file's admission."""

    format: str
    env_version: int | None = None  # in which its robot was trained, as it says


@dataclasses.dataclass(frozen=True)
class Draft:
    """A submission as it was handed in."""

    task: str
    method: str
    request: str  # chosen by the client: the same one is the same submission
    licence: str = "evaluation-only"
    season: str | None = None  # id; None for the public board alone
    entry: str | None = None  # id of the declared entry that it is a seed of
    kind: Kind = "file"
    data: bytes | None = None  # of a file alone
    format: str | None = None  # as admission found it; of a reference its name
    refusal: str | None = None  # as admission found it
    env_version: int | None = None  # in which it was trained, as its file says
    about: str | None = None  # what the submitter says of the method, on its page
    link: str | None = None
    citation: str | None = None


def check_draft(draft: Draft, catalogue: Catalogue) -> None:
    """Check the fields of a draft, before its file is admitted.

    Raises:
        Problem: A field is not of the form.
    """
    if draft.task not in catalogue.tasks:
        raise Problem("invalid", f"task {draft.task!r}; allowed are {', '.join(catalogue.tasks)}")
    if draft.licence not in LICENCES:
        raise Problem("invalid", f"licence {draft.licence!r}; allowed are {', '.join(LICENCES)}")
    entries.check_names(draft.method, draft.request)
    _check_description(draft)
    if (draft.data is not None) != (draft.kind == "file"):
        raise Problem("invalid", "a submission is a file")
    if draft.data is not None and len(draft.data) > MAX_BYTES:
        raise Problem("too_large", f"a file has at most {MAX_BYTES} bytes")


def _check_description(draft: Draft) -> None:
    for name, most in DESCRIPTION.items():
        text = getattr(draft, name) or ""
        if len(text) > most or not text.replace("\n", "").isprintable():
            raise Problem("invalid", f"{name} has at most {most} printable characters")
    if draft.link and not LINK.fullmatch(draft.link):
        raise Problem("invalid", "link begins with https:// or http:// and holds no spaces")


def known(database: Database, submitter: str, request: str) -> str | None:
    """Return the submission that a request made when it came before."""
    with database.read() as connection:
        return _known(connection, submitter, request)


def submit(
    transaction: Transaction,
    artefacts: Artefacts,
    catalogue: Catalogue,
    submitter: str,
    draft: Draft,
) -> str:
    """Record a submission with its jobs, and return its id; a repeated request adds nothing."""
    _check_not_erased(transaction, submitter)
    if before := _known(transaction, submitter, draft.request):
        return before
    season = entries.open_season(transaction, draft.season, draft.task) if draft.season else None
    if season is not None and draft.refusal is None:
        entries.check_attempts(transaction, season, submitter)
    public = catalogue.identity(draft.task).get("env_version")
    row = _row(transaction, submitter, draft)
    row["warning"] = warning_of(draft.env_version, public, season)
    entry = None
    if draft.entry:
        entry = entries.place_in_entry(transaction, submitter, draft.entry, row)
    if draft.data is not None and draft.refusal is None:
        note_copy(transaction, row)
        record_artefact(transaction, artefacts.put(draft.data), len(draft.data))
    else:
        row["artefact"] = None
    transaction.execute(sa.insert(schema.submissions).values(row))
    if draft.refusal is not None:
        _end_entry(transaction, draft.entry)
    for planned in (row,) if entry is None else entries.freeze(transaction, entry):
        if draft.refusal is None:
            plan_jobs(transaction, catalogue, planned, season)
    names = ("id", "submitter", "task", "kind", "artefact", "season", "entry", "state", "reason")
    body = {name: row[name] for name in names}
    transaction.record("submission", body)
    return row["id"]


def plan_jobs(
    transaction: Transaction,
    catalogue: Catalogue,
    row: Any,
    season: Any | None,
) -> None:
    """Cut a submission into jobs: the public panel, and then panel A of its season.

    Panel A is held back until the public half is done: a robot that breaks down does so before it
    has met anybody hidden.
    """
    version = record_version(transaction, catalogue, row["task"])
    public = len(cut(catalogue.public_panel(row["task"]), CHUNK))
    order: dict[str, Any] = {"turn": row["turn"]}
    jobs.add_jobs(transaction, row["id"], version, "public", public, **order)
    if season is not None:
        hidden = count_chunks(season.panel_sizes["A"])
        jobs.add_jobs(transaction, row["id"], version, "A", hidden, held=True, **order)


def record_version(transaction: Transaction, catalogue: Catalogue, task: str) -> str:
    """Note the version that a task is scored under now, once, and return its id."""
    identity = catalogue.identity(task)
    version = version_id(identity)
    row = {"id": version, "task": task, "identity": identity, "created_at": transaction.now}
    transaction.insert_once(schema.versions, row)
    return version


def count_chunks(partners: int) -> int:
    """Return the number of jobs that a panel is cut into."""
    return -(-partners // CHUNK)


def fail(transaction: Transaction, id: str, reason: str) -> None:
    """End a submission without a score; one that has ended stays as it is."""
    row = find_submission(transaction, id)
    if row is None or row.state in FINAL_STATES:
        return
    spent = row.season is not None and reason in OWN_FAILURES and _met_hidden(transaction, id)
    end(transaction, row, "failed", reason, "spent" if spent else "refunded")


def refuse(transaction: Transaction, id: str, code: str) -> None:
    """End a submission that a worker could not play for the robot's own fault."""
    row = find_submission(transaction, id)
    if row is None or row.state in FINAL_STATES:
        return
    if row.season is not None and _met_hidden(transaction, id):
        reason = code if code == "too_slow" else "broke_down"
        end(transaction, row, "failed", reason, "spent")
    else:
        end(transaction, row, "refused", code, "refunded")


def end(
    transaction: Transaction,
    row: Any,
    state: str,
    reason: str | None,
    attempt: str,
) -> None:
    """Bring a submission to its end, in state, attempt, queue and ledger."""
    attempt = attempt if row.season is not None else "free"
    values = {"state": state, "reason": reason, "attempt": attempt, "finished_at": transaction.now}
    transaction.execute(sa.update(schema.submissions).where(SUBMISSION.id == row.id).values(values))
    jobs.cancel_jobs(transaction, row.id)
    body = {"id": row.id, "state": state, "reason": reason, "attempt": attempt}
    transaction.record("end", body)


def withdraw(transaction: Transaction, id: str, submitter: str) -> None:
    """End a submission because its submitter wants so; of an entry all of its seeds."""
    row = find_submission(transaction, id)
    if row is None or row.submitter != submitter:
        raise Problem("not_found", f"you have no submission {id!r}")
    if row.entry is not None:
        for seed in entries.seeds_of(transaction, row.entry):
            fail(transaction, seed, "withdrawn")
    elif row.state == "scored":
        _retract(transaction, row)
    elif row.state in FINAL_STATES:
        raise Problem("too_late", f"submission {id} has ended: {row.state}")
    else:
        fail(transaction, id, "withdrawn")


def _retract(transaction: Transaction, row: Any) -> None:
    """Take a scored submission off its board; its score, attempt and receipt stay known."""
    closing = sa.select(SEASON.name).where(SEASON.id == row.season, SEASON.state == "closing")
    if name := transaction.execute(closing).scalar():
        raise Problem(
            "too_late",
            f"season {name} is closing, so its submissions can no longer be withdrawn",
        )
    values = {"state": "retracted", "reason": "withdrawn", "entered_at": None}
    transaction.execute(sa.update(schema.submissions).where(SUBMISSION.id == row.id).values(values))
    jobs.cancel_jobs(transaction, row.id)
    transaction.record("retract", {"id": row.id})


def find_submission(transaction: Transaction, id: str) -> Any:
    """Return a submission's row, or None if there is no such submission."""
    query = sa.select(schema.submissions).where(SUBMISSION.id == id)
    return transaction.execute(query).first()


def _known(reader: Reader, submitter: str, request: str) -> str | None:
    where = SUBMISSION.submitter == submitter, SUBMISSION.request == request
    return reader.execute(sa.select(SUBMISSION.id).where(*where)).scalar()


def _check_not_erased(transaction: Transaction, submitter: str) -> None:
    erased = sa.select(SUBMITTER.erased_at).where(SUBMITTER.id == submitter)
    if transaction.execute(erased).scalar() is not None:
        raise Problem(
            "not_signed_in", "this token's lab was erased; ask the organiser for a new token"
        )


def _row(transaction: Transaction, submitter: str, draft: Draft) -> dict[str, Any]:
    refused = draft.refusal is not None
    attempt = "free" if draft.season is None else "refunded" if refused else "reserved"
    waiting = sa.select(sa.func.count()).where(
        SUBMISSION.submitter == submitter, SUBMISSION.state.not_in(FINAL_STATES)
    )
    return {
        "id": new_id(),
        "submitter": submitter,
        "request": draft.request,
        "task": draft.task,
        "method": draft.method,
        "kind": draft.kind,
        "artefact": None if draft.data is None else sha256(draft.data),
        "format": draft.format,
        "licence": draft.licence,
        "season": draft.season,
        "entry": draft.entry,
        "state": "refused" if refused else "queued",
        "reason": draft.refusal,
        "attempt": attempt,
        # Who has more in the queue waits longer: one lab cannot keep all others out.
        "turn": LAST if draft.kind == "reference" else transaction.execute(waiting).scalar_one(),
        "created_at": transaction.now,
        "finished_at": transaction.now if refused else None,
        **{name: getattr(draft, name) or None for name in DESCRIPTION},
    }


def _end_entry(transaction: Transaction, entry: str | None) -> None:
    """End an entry of which a file was refused: it cannot be whole any more."""
    waiting = sa.select(SUBMISSION.id).where(SUBMISSION.entry == entry)
    for id in transaction.execute(waiting).scalars().all() if entry else ():
        fail(transaction, id, "entry_incomplete")


def note_copy(transaction: Transaction, row: dict[str, Any]) -> None:
    """Tell the organiser if another lab handed in the same bytes before."""
    same = SUBMISSION.artefact == row["artefact"], SUBMISSION.task == row["task"]
    others = sa.select(SUBMISSION.id).where(*same, SUBMISSION.submitter != row["submitter"])
    if transaction.execute(others.limit(1)).first():
        note(transaction, "same_bytes", row["artefact"])


def _met_hidden(transaction: Transaction, id: str) -> bool:
    """Return whether a worker ever took up a hidden panel of this submission."""
    query = sa.select(JOB.id).where(
        JOB.submission == id, JOB.panel == "A", JOB.leased_at.is_not(None)
    )
    return transaction.execute(query.limit(1)).first() is not None


def admitted(admit: Any, draft: Draft) -> Draft:
    """Return the draft with its file's format, or with the reason of its refusal."""
    if draft.data is None:
        return draft
    try:
        return dataclasses.replace(draft, **admit(draft.data, draft.task)._asdict())
    except Refusal as refusal:
        return dataclasses.replace(draft, refusal=refusal.code)
