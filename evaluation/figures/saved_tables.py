"""What is drawn from an episode table and saved beside it: partners, profile, matrix and order."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from evaluation.cast.met_partners import (
    NOTHING_KNOWN,
    MetPartners,
    check_new,
    crossplay_notes,
    left_out,
    met_notes,
    without_met,
)
from evaluation.figures.bootstrap import estimate, profile_band
from evaluation.figures.normalised import summarise_references
from evaluation.figures.statistics import performance_profile
from evaluation.figures.summary import (
    Context,
    CrossPlaySummary,
    EvaluationSummary,
    summarise_crossplay,
    summarise_evaluation,
)
from evaluation.record import tables
from evaluation.record.tables import dense_block

POINTS = 101  # of a performance profile


def partner_table(table: pl.DataFrame) -> pl.DataFrame:
    """Average over egos and episodes: one row a partner.

    `return_low` and `return_high` are the ends of its mean's 95% interval over seeds and starts.
    """
    block, table = dense_block(table), tables.with_safety(table)
    measures = tables.outcome_columns(table)
    means = table.group_by("partner").agg(
        *(pl.col(name).cast(pl.Float64).mean() for name in measures),
        pl.len().cast(pl.Int64).alias("episodes"),
        pl.col("nonfinite").sum().cast(pl.Int64),
    )
    figures = [estimate(block.returns[:, [place]]) for place in range(block.partners.height)]
    intervals = [figure.mean_ci or (None, None) for figure in figures]
    returns = pl.DataFrame(
        {
            "partner": block.partners["partner"],
            "return": [figure.mean for figure in figures],
            "return_low": [low for low, _ in intervals],
            "return_high": [high for _, high in intervals],
        },
        schema_overrides={"return_low": pl.Float64, "return_high": pl.Float64},
    )
    described = block.partners.join(returns, on="partner", maintain_order="left")
    return described.join(means, on="partner", maintain_order="left")


def profile_table(table: pl.DataFrame) -> pl.DataFrame:
    """Return the performance profile of the evaluated side.

    Threshold, share above it, low, high.
    """
    scores = dense_block(table).evaluated_side().scores
    thresholds = np.linspace(min(0.0, scores.min()), scores.max(), POINTS)
    low, high = profile_band(scores, thresholds) or (None, None)
    share = performance_profile(scores, thresholds)
    return pl.DataFrame(
        {"threshold": thresholds, "share": share, "low": low, "high": high},
        schema=dict.fromkeys(("threshold", "share", "low", "high"), pl.Float64),
    )


def crossplay_matrix(table: pl.DataFrame) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Return the matrix in long form, one row a pair, and its clustered order.

    The order has `rows` and `columns`, clustered separately, and `teams`: one order for both axes,
    with self-play on the diagonal, or None unless both axes have the same teams.
    """
    from evaluation.figures.clustering import (  # SciPy: an evaluation has none
        cluster_profiles,
        cluster_teams,
    )

    block = dense_block(table)
    scores = block.scores
    order = {
        "linkage": "average",
        "distance": "euclidean",
        "rows": cluster_profiles(scores).to_json(block.egos["ego"].to_list()),
        "columns": cluster_profiles(scores.T).to_json(block.partners["partner"].to_list()),
        "teams": None,
    }
    rows, columns = block.egos["ego_team"].to_list(), block.partners["partner_team"].to_list()
    whole = None not in rows and len(set(rows)) == len(rows)
    if whole and sorted(rows) == sorted(columns, key=str):
        square = scores[:, [columns.index(team) for team in rows]]
        order["teams"] = cluster_teams(square).to_json(rows)
    return tables.pair_table(table), order


def save_evaluation(
    folder: Path,
    table: pl.DataFrame,
    context: Context,
    *,
    include_own: bool = False,
    references: tuple[pl.DataFrame, pl.DataFrame] | None = None,
    met: MetPartners = NOTHING_KNOWN,
) -> EvaluationSummary:
    """Write every table drawn from an evaluation's episodes, and its summary.

    Args:
        folder: Where the episodes are.
        table: The episodes.
        context: What they do not say of themselves.
        include_own: Whether figures count partners that were trained with one of the egos.
        references: Episodes of the reference egos and the bounds drawn from them, if they played.
        met: Which partners the egos met in training.

    Raises:
        ValueError: The egos met all partners, or all of the test side.
    """
    left = left_out(table, met)
    check_new(dict(table.select("partner", "side").unique().rows()), left, include_own)
    counted = table if include_own else without_met(table, met)
    summary = summarise_evaluation(counted, context)
    notes = (*summary.notes, *met_notes(table, met, include_own))
    told = met.summary([] if include_own else left)
    summary = dataclasses.replace(summary, notes=notes, met=told)
    tables.write_parquet(partner_table(table), folder / tables.PARTNERS_FILE)
    tables.write_parquet(profile_table(counted), folder / tables.PROFILE_FILE)
    written = [tables.PARTNERS_FILE, tables.PROFILE_FILE, tables.SUMMARY_FILE]
    if references is not None:
        played, bounds = references
        written += [tables.REFERENCES_FILE, tables.BOUNDS_FILE]
        tables.write_parquet(played, folder / tables.REFERENCES_FILE)
        tables.write_parquet(bounds, folder / tables.BOUNDS_FILE)
        found, relative = summarise_references(counted, played, bounds)
        summary = dataclasses.replace(summary, references=found, relative=relative)
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    tables.remove_derived(folder, but=written)  # drawn from these episodes with other options
    return summary


def save_crossplay(
    folder: Path, table: pl.DataFrame, context: Context, met: MetPartners = NOTHING_KNOWN
) -> CrossPlaySummary:
    """Write pairs, their clustered order, the partners' strategies, and the summary."""
    from evaluation.figures.strategies import summarise_strategies

    summary = summarise_crossplay(table, context)
    summary = dataclasses.replace(summary, notes=(*summary.notes, *crossplay_notes(met)))
    written = [tables.PAIRS_FILE, tables.ORDER_FILE, tables.SUMMARY_FILE]
    pairs, order = crossplay_matrix(table)
    tables.write_parquet(pairs, folder / tables.PAIRS_FILE)
    if set(tables.BEHAVIOUR) <= set(pairs.columns):
        tables.write_json(summarise_strategies(pairs), folder / tables.STRATEGIES_FILE)
        written.append(tables.STRATEGIES_FILE)
    tables.write_json(order, folder / tables.ORDER_FILE)
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    tables.remove_derived(folder, but=written)
    return summary
