"""From results to scores: a result is taken once, and the last one of a panel makes its score."""

import dataclasses
import io
from typing import Any

import numpy as np
import polars as pl
import sqlalchemy as sa

from assistax_board.problems import Problem
from assistax_board.rules import closing, jobs, submissions
from assistax_board.rules.scoring import decode_table, table_bytes
from assistax_board.store import ledger, schema
from assistax_board.store.artefacts import Artefacts, record_artefact
from assistax_board.store.database import Database, insert_once
from assistax_board.store.receipts import Signer
from assistax_board.store.schema import JOB, RESULT, SCORE, SEASON, SUBMISSION
from assistax_board.vocabulary import FINAL_STATES


@dataclasses.dataclass(frozen=True)
class ResultStore:
    """What accepting a result needs."""

    database: Database
    artefacts: Artefacts
    signer: Signer


def accept(
    store: ResultStore,
    job: str,
    secret: str,
    data: bytes,
    partners: tuple[str, ...],
    episodes: int,
    preferences: tuple[str, ...],
    seconds: float,
    now: float,
) -> bool:
    """Take a job's result; return False where it was there already.

    Raises:
        Problem: The lease was not the last to hold this job, or the table is not of this job.
    """
    with store.database.read() as connection:
        row = jobs.held_job(connection, job, secret)
    if row is None or row.state == "cancelled":
        raise Problem("lease_lost", "this job is no longer yours; take the next")
    kept = table_bytes(decode_table(data, partners, episodes, preferences))
    name = store.artefacts.put(kept)
    with store.database.write() as connection:
        held = jobs.held_job(connection, job, secret)
        if held is None or held.state not in ("leased", "waiting"):
            return False
        record_artefact(connection, name, len(kept), now)
        result = {"table": name, "seconds": seconds, "created_at": now}
        result |= {key: getattr(row, key) for key in ("submission", "version", "panel", "chunk")}
        if not insert_once(connection, schema.results, result):
            return False
        connection.execute(
            sa.update(schema.jobs).where(JOB.id == job).values(state="done", done_at=now)
        )
        if _left(connection, row, row.panel) == 0:
            _finish_panel(store, connection, row, now)
    return True


def _left(connection: sa.Connection, job: Any, *panels: str) -> int:
    """Return how many jobs of these panels are not done."""
    where = [
        JOB.submission == job.submission,
        JOB.version == job.version,
        JOB.panel.in_(panels),
        JOB.state != "done",
    ]
    return connection.execute(sa.select(sa.func.count()).where(*where)).scalar_one()


def _finish_panel(store: ResultStore, connection: sa.Connection, job: Any, now: float) -> None:
    """Make the score of a panel whose last result has come, and go on to what comes next."""
    table = panel_table(store.artefacts, connection, job.submission, job.version, job.panel)
    row = {
        "submission": job.submission,
        "version": job.version,
        "panel": job.panel,
        "figures": figures(table),
        "created_at": now,
    }
    # Panel B is played when nobody submits any more: all of it may be shown.
    row["released"] = row["figures"] if job.panel == "B" else None
    connection.execute(sa.insert(schema.scores).values(row))
    if job.panel == "B":
        _finish_b(store, connection, job, row["figures"], now)
        return
    if job.panel == "public":
        connection.execute(sa.insert(schema.partner_scores), _partner_rows(job, table))
        jobs.release_held(connection, job.submission, job.version)
    if _left(connection, job, "public", "A") == 0:
        _release(store, connection, job, now)


def _finish_b(
    store: ResultStore, connection: sa.Connection, job: Any, figures: dict[str, Any], now: float
) -> None:
    """Note a score on panel B, and reveal the season after its last one."""
    body = {"id": job.submission, "version": job.version, "released": {"B": figures}}
    ledger.append(connection, now, "score", body)
    row = submissions.find_submission(connection, job.submission)
    if row.state not in FINAL_STATES:  # a reference plays this panel alone
        submissions.end(connection, row, "scored", None, "spent", now)
    closing.go_on(connection, row.season, now)


def panel_table(
    artefacts: Artefacts, connection: sa.Connection, submission: str, version: str, panel: str
) -> pl.DataFrame:
    """Return all episodes of a panel, in the order of its chunks."""
    where = RESULT.submission == submission, RESULT.version == version, RESULT.panel == panel
    names = connection.execute(
        sa.select(RESULT.table).where(*where).order_by(RESULT.chunk)
    ).scalars()
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

    Of a gentle task also how often somebody was hurt, and the mean return under each preference.
    """
    from evaluation.figures.bootstrap import estimate
    from evaluation.record import tables
    from evaluation.record.columns import with_safety

    values = {
        **tables.to_json(estimate(partner_means(table)[None, :])),
        "nonfinite": int(table["nonfinite"].sum()),
        "success": float(table["success"].to_numpy().mean()),
    }
    if "preference" not in table.columns:
        return values
    safe = with_safety(table)["safe_success"]
    liked = table.group_by("preference").agg(pl.col("return").cast(pl.Float64).mean())
    return values | {
        "safe_success": float(safe.to_numpy().mean()),
        "violations": float(table["violated"].to_numpy().mean()),
        "by_preference": dict(liked.sort("preference").rows()),
    }


def partner_means(table: pl.DataFrame) -> np.ndarray:
    """Return the mean return with each partner [P], in the order of their ids."""
    means = table.group_by("partner").agg(pl.col("return").cast(pl.Float64).mean())
    return means.sort("partner")["return"].to_numpy()


def _partner_rows(job: Any, table: pl.DataFrame) -> list[dict[str, Any]]:
    grouped = (
        table.sort("partner", "episode")
        .group_by("partner", "algorithm", "disability", maintain_order=True)
        .agg(pl.col("return").alias("returns"), pl.col("success").sum().alias("successes"))
    )
    identity = {"submission": job.submission, "version": job.version}
    return [{**identity, **row} for row in grouped.to_dicts()]


def _release(store: ResultStore, connection: sa.Connection, job: Any, now: float) -> None:
    """Show what may be shown, end the submission, and sign the receipt: all in one transaction."""
    mine = (SCORE.submission == job.submission) & (SCORE.version == job.version)
    query = sa.select(SCORE.panel, SCORE.figures).where(mine)
    scores = {row.panel: row.figures for row in connection.execute(query)}
    shown = {"public": scores["public"]}
    row = submissions.find_submission(connection, job.submission)
    if "A" in scores and (answer := _hidden_answer(store, connection, job, row)):
        shown["A"] = answer
    for panel, value in shown.items():
        update = sa.update(schema.scores).where(mine, SCORE.panel == panel)
        connection.execute(update.values(released=value))
    body = {"id": row.id, "version": job.version, "released": shown}
    entry = ledger.append(connection, now, "score", body)
    if row.state not in FINAL_STATES:
        submissions.end(connection, row, "scored", None, "spent", now)
    _sign(store, connection, row, job.version, shown, entry, now)
    if row.season is not None:
        closing.go_on(connection, row.season, now)


def _hidden_answer(
    store: ResultStore, connection: sa.Connection, job: Any, row: Any
) -> dict[str, Any] | None:
    """Return what the Ladder shows of panel A: a rounded mean, or nothing."""
    from assistax_board.places.ladder import ladder_release

    def means(submission: str) -> np.ndarray:
        table = panel_table(store.artefacts, connection, submission, job.version, "A")
        return partner_means(table)

    best = _shown_last(connection, row, job.version)
    new = means(row.id)
    attempt = 1 + _scored_before(connection, row, job.version)
    value = ladder_release(None if best is None else means(best), new, attempt=attempt)
    return None if value is None else {"mean": value, "n": int(new.size)}


def _scored_before(connection: sa.Connection, row: Any, version: str) -> int:
    """Return how many other submissions of this lab panel A has scored in this season."""
    query = (
        sa.select(sa.func.count())
        .select_from(schema.scores)
        .join(schema.submissions, SUBMISSION.id == SCORE.submission)
        .where(
            SUBMISSION.season == row.season,
            SUBMISSION.submitter == row.submitter,
            SUBMISSION.id != row.id,
        )
        .where(SCORE.panel == "A", SCORE.version == version)
    )
    return connection.execute(query).scalar_one()


def _shown_last(connection: sa.Connection, row: Any, version: str) -> str | None:
    """Return the submission of this lab whose score on panel A was shown last in this season."""
    query = (
        sa.select(SCORE.submission)
        .join(schema.submissions, SUBMISSION.id == SCORE.submission)
        .where(
            SUBMISSION.season == row.season,
            SUBMISSION.submitter == row.submitter,
            SUBMISSION.id != row.id,
        )
        .where(SCORE.panel == "A", SCORE.version == version, SCORE.released.is_not(None))
        .order_by(SCORE.created_at.desc())
    )
    return connection.execute(query.limit(1)).scalar()


def _sign(
    store: ResultStore,
    connection: sa.Connection,
    row: Any,
    version: str,
    shown: dict[str, Any],
    entry: Any,
    now: float,
) -> None:
    content = {
        "submission": row.id,
        "task": row.task,
        "method": row.method,
        "artefact": row.artefact,
        "season": row.season,
        "version": version,
        "scores": shown,
        "ledger": {"seq": entry.seq, "hash": entry.hash},
        "issued_at": now,
        "key": store.signer.public_key,
    }
    values = {
        "submission": row.id,
        "version": version,
        "content": content,
        "signature": store.signer.sign(content),
        "created_at": now,
    }
    connection.execute(sa.insert(schema.receipts).values(values))
