"""From results to scores: a result is taken once, and the last one of a panel makes its score."""

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
import sqlalchemy as sa

from assistax_board.places.caring import care_of
from assistax_board.problems import Problem
from assistax_board.rules import closing, jobs, submissions
from assistax_board.rules.scoring import decode_table, table_bytes
from assistax_board.store import schema
from assistax_board.store.artefacts import Artefacts, record_artefact
from assistax_board.store.database import Database, Reader, Transaction
from assistax_board.store.schema import JOB, RESULT, SCORE, SEASON, SUBMISSION
from assistax_board.vocabulary import FINAL_STATES
from assistax_envs.persons.rows import groups_of

if TYPE_CHECKING:
    from assistax_board.service import Service


def accept(
    service: "Service",
    job: str,
    secret: str,
    data: bytes,
    partners: tuple[str, ...],
    episodes: int,
    preferences: tuple[str, ...],
    seconds: float,
) -> bool:
    """Take a job's result; return False if it was there already.

    Raises:
        Problem: The lease was not the last to hold this job, or the table is not of this job.
    """
    with service.database.read() as connection:
        row = jobs.held_job(connection, job, secret)
    if row is None or row.state == "cancelled":
        raise Problem("lease_lost", "this job is no longer yours; take the next")
    packed = table_bytes(decode_table(data, partners, episodes, preferences))
    name = service.artefacts.put(packed)
    with service.begin() as transaction:
        held = jobs.held_job(transaction, job, secret)
        if held is None or held.state not in ("leased", "waiting"):
            return False
        record_artefact(transaction, name, len(packed))
        result = {"table": name, "seconds": seconds, "created_at": transaction.now}
        result |= {key: getattr(row, key) for key in ("submission", "version", "panel", "chunk")}
        if not transaction.insert_once(schema.results, result):
            return False
        transaction.execute(
            sa.update(schema.jobs)
            .where(JOB.id == job)
            .values(state="done", done_at=transaction.now)
        )
        if _count_unfinished(transaction, row, row.panel) == 0:
            _score_panel(service, transaction, row)
    return True


def _count_unfinished(transaction: Transaction, job: Any, *panels: str) -> int:
    """Return the number of unfinished jobs of these panels."""
    where = [
        JOB.submission == job.submission,
        JOB.version == job.version,
        JOB.panel.in_(panels),
        JOB.state != "done",
    ]
    return transaction.execute(sa.select(sa.func.count()).where(*where)).scalar_one()


def _score_panel(service: "Service", transaction: Transaction, job: Any) -> None:
    """Score a complete panel, then start the next."""
    table = panel_table(service.artefacts, transaction, job.submission, job.version, job.panel)
    row = {
        "submission": job.submission,
        "version": job.version,
        "panel": job.panel,
        "figures": figures(table),
        "created_at": transaction.now,
    }
    # Panel B is played after the close of submissions, so all of it may be shown.
    row["released"] = row["figures"] if job.panel == "B" else None
    transaction.execute(sa.insert(schema.scores).values(row))
    if job.panel == "B":
        _record_b(service, transaction, job, row["figures"])
        return
    if job.panel == "public":
        transaction.execute(sa.insert(schema.partner_scores), _partner_rows(job, table))
        jobs.release_held(transaction, job.submission, job.version)
    if _count_unfinished(transaction, job, "public", "A") == 0:
        _release(service, transaction, job)


def _record_b(
    service: "Service", transaction: Transaction, job: Any, figures: dict[str, Any]
) -> None:
    """Note a score on panel B, and reveal the season after its last one."""
    body = {"id": job.submission, "version": job.version, "released": {"B": figures}}
    transaction.record("score", body)
    row = submissions.find_submission(transaction, job.submission)
    if row.state not in FINAL_STATES:  # a reference plays this panel alone
        submissions.end(transaction, row, "scored", None, "spent")
    closing.take_next_step(transaction, row.season)


def panel_table(
    artefacts: Artefacts, reader: Reader, submission: str, version: str, panel: str
) -> pl.DataFrame:
    """Return all episodes of a panel, in the order of its chunks."""
    where = RESULT.submission == submission, RESULT.version == version, RESULT.panel == panel
    names = reader.execute(sa.select(RESULT.table).where(*where).order_by(RESULT.chunk)).scalars()
    return pl.concat([pl.read_parquet(io.BytesIO(artefacts.get(name))) for name in names])


def panel_b(
    database: Database, artefacts: Artefacts, season: str
) -> list[tuple[str, pl.DataFrame]]:
    """Return the episodes of every submission on the panel B of a season, once it is closed."""
    query = (
        sa.select(SCORE.submission, SCORE.version)
        .join(schema.submissions, SUBMISSION.id == SCORE.submission)
        .join(schema.seasons, SEASON.id == SUBMISSION.season)
        .where(SEASON.id == season, SEASON.state == "closed", SCORE.panel == "B")
        .where(SUBMISSION.reason.is_distinct_from("disqualified"))
        .order_by(SCORE.created_at.desc(), SCORE.submission)
    )
    with database.read() as connection:
        rows = connection.execute(query).all()
        newest = [row for row in rows if row.version == rows[0].version]
        return [
            (row.submission, panel_table(artefacts, connection, row.submission, row.version, "B"))
            for row in newest
        ]


def figures(table: pl.DataFrame) -> dict[str, Any]:
    """Return mean and IQM over partners with intervals, successes, and broken episodes.

    If the partners have groups, mean and IQM are means of the groups' and `by_group` has each.
    Of a gentle task also how people fared, and the mean return under each preference.
    """
    from assistax_board.places.boards import estimate_of
    from evaluation.record import tables

    means, groups = partner_means(table)
    whole, by_group = estimate_of(means[None, :], groups)
    values = {
        **tables.to_json(whole),
        **({"by_group": tables.to_json(by_group)} if by_group else {}),
        "nonfinite": int(table["nonfinite"].sum()),
        "success": float(table["success"].to_numpy().mean()),
    }
    if "preference" not in table.columns:
        return values
    by_preference = table.group_by("preference").agg(pl.col("return").cast(pl.Float64).mean())
    preferences = {"by_preference": dict(by_preference.sort("preference").rows())}
    return values | care_of(table) | preferences


def partner_means(table: pl.DataFrame) -> tuple[np.ndarray, tuple[str, ...] | None]:
    """Return the mean return with each partner [P], in the order of their ids, and its group."""
    mean = pl.col("return").cast(pl.Float64).mean()
    means = table.group_by("partner").agg(mean, pl.col("algorithm").first()).sort("partner")
    return means["return"].to_numpy(), groups_of(means["algorithm"].to_list())


def _partner_rows(job: Any, table: pl.DataFrame) -> list[dict[str, Any]]:
    grouped = (
        table.sort("partner", "episode")
        .group_by("partner", "algorithm", "disability", maintain_order=True)
        .agg(pl.col("return").alias("returns"), pl.col("success").sum().alias("successes"))
    )
    identity = {"submission": job.submission, "version": job.version}
    return [{**identity, **row} for row in grouped.to_dicts()]


def _release(service: "Service", transaction: Transaction, job: Any) -> None:
    """Release the scores, end the submission and sign its receipt, all in one transaction."""
    mine = (SCORE.submission == job.submission) & (SCORE.version == job.version)
    query = sa.select(SCORE.panel, SCORE.figures).where(mine)
    scores = {row.panel: row.figures for row in transaction.execute(query)}
    released = {"public": scores["public"]}
    row = submissions.find_submission(transaction, job.submission)
    if "A" in scores and (answer := _hidden_answer(service, transaction, job, row)):
        released["A"] = answer
    for panel, value in released.items():
        update = sa.update(schema.scores).where(mine, SCORE.panel == panel)
        transaction.execute(update.values(released=value))
    body = {"id": row.id, "version": job.version, "released": released}
    entry = transaction.record("score", body)
    if row.state not in FINAL_STATES:
        submissions.end(transaction, row, "scored", None, "spent")
    _sign(service, transaction, row, job.version, released, entry)
    if row.season is not None:
        closing.take_next_step(transaction, row.season)


def _hidden_answer(
    service: "Service", transaction: Transaction, job: Any, row: Any
) -> dict[str, Any] | None:
    """Return the Ladder's answer for panel A: a rounded mean, or None for silence.

    What was silent under another version stays silent, and the bar stays that of the attempt that
    was shown last under any: an upgrade must not begin the Ladder anew.
    """
    from assistax_board.places.ladder import ladder_release
    from evaluation.figures.metrics import group_weights

    def means(submission: str, version: str) -> np.ndarray:
        """Return means with partners whose mean is that of the groups' means."""
        table = panel_table(service.artefacts, transaction, submission, version, "A")
        values, groups = partner_means(table)
        return values if groups is None else values * group_weights(groups)

    of_a = sa.select(SCORE.submission).where(SCORE.panel == "A")
    silent = of_a.where(SCORE.submission == row.id, SCORE.released.is_(None))
    if transaction.execute(silent.where(SCORE.version != job.version)).first():
        return None
    before = _answered_before(transaction, row, of_a)
    shown = _answered_before(transaction, row, of_a.where(SCORE.released.is_not(None)))[:1]
    best = [means(id, _version_of_bar(transaction, id, job.version)) for id in shown]
    new = means(row.id, job.version)
    value = ladder_release(best[0] if best else None, new, attempt=1 + len(before))
    return None if value is None else {"mean": value, "n": int(new.size)}


def _answered_before(transaction: Transaction, row: Any, among: sa.Select) -> Sequence[str]:
    """Return this lab's other submissions in the season that were answered before, the last first.

    `finished_at` is the time of the first answer, also of a submission that is played anew.
    """
    query = sa.select(SUBMISSION.id).where(
        SUBMISSION.season == row.season,
        SUBMISSION.submitter == row.submitter,
        SUBMISSION.id != row.id,
        SUBMISSION.id.in_(among),
    )
    if row.finished_at is not None:
        order = sa.tuple_(SUBMISSION.finished_at, SUBMISSION.id)
        query = query.where(order < sa.tuple_(row.finished_at, row.id))
    query = query.order_by(SUBMISSION.finished_at.desc(), SUBMISSION.id.desc())
    return transaction.execute(query).scalars().all()


def _version_of_bar(transaction: Transaction, submission: str, version: str) -> str:
    """Return the version of a submission's panel A to compare with: this one, else the newest."""
    query = sa.select(SCORE.version).where(SCORE.submission == submission, SCORE.panel == "A")
    query = query.order_by((SCORE.version == version).desc(), SCORE.created_at.desc())
    return transaction.execute(query.limit(1)).scalar_one()


def _sign(
    service: "Service",
    transaction: Transaction,
    row: Any,
    version: str,
    released: dict[str, Any],
    entry: Any,
) -> None:
    content = {
        "submission": row.id,
        "task": row.task,
        "method": row.method,
        "artefact": row.artefact,
        "season": row.season,
        "entry": row.entry,
        "version": version,
        "scores": released,
        "ledger": {"seq": entry.seq, "hash": entry.hash},
        "issued_at": transaction.now,
        "key": service.signer.public_key,
    }
    values = {
        "submission": row.id,
        "version": version,
        "content": content,
        "signature": service.signer.sign(content),
        "created_at": transaction.now,
    }
    transaction.execute(sa.insert(schema.receipts).values(values))
