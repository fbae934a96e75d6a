"""Tables made from an episode table and saved beside it: partners, profile, matrix and order."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from assistax_base.statistics import performance_profile
from evaluation.cast.met_partners import (
    NOTHING_KNOWN,
    MetPartners,
    check_new,
    crossplay_notes,
    left_out,
    met_notes,
)
from evaluation.figures.bootstrap import estimate, profile_band
from evaluation.figures.metrics.installed import InstalledMetric
from evaluation.figures.normalised import summarise_references
from evaluation.figures.summary import (
    Context,
    CrossPlaySummary,
    EvaluationSummary,
    summarise_crossplay,
    summarise_evaluation,
)
from evaluation.record import tables
from evaluation.record.columns import BEHAVIOUR, outcome_columns, term_columns
from evaluation.record.record import Record

POINTS = 101  # of a performance profile


def partner_table(record: Record) -> pl.DataFrame:
    """Return the partners' means over egos and episodes, one row a partner.

    `return_low` and `return_high` are the ends of its mean's 95% interval over seeds and starts.
    """
    returns, table = record.returns, record.table
    figures = [estimate(returns.values[:, [place]]) for place in range(returns.partners.height)]
    intervals = [figure.mean_ci or (None, None) for figure in figures]
    described = returns.partners.with_columns(
        pl.Series("return", [figure.mean for figure in figures]),
        pl.Series("return_low", [low for low, _ in intervals], pl.Float64),
        pl.Series("return_high", [high for _, high in intervals], pl.Float64),
    )
    means = table.group_by("partner").agg(*_means(outcome_columns(table)), *_COUNTS)
    return described.join(means, on="partner", maintain_order="left")


def pair_table(record: Record) -> pl.DataFrame:
    """Return the pairs' means over episodes, one row a pair, in the order of `record.returns`."""
    returns, table = record.returns, record.table
    behaviour = [name for name in BEHAVIOUR if name in table.columns]
    measures = ("discounted_return", *term_columns(table), *outcome_columns(table), *behaviour)
    means = table.group_by("ego", "partner").agg(
        *_means(["return"]),
        pl.col("return").cast(pl.Float64).std().alias("return_sd"),
        *_means(measures),
        *_COUNTS,
    )
    pairs = returns.egos.join(returns.partners, how="cross", maintain_order="left_right")
    return pairs.join(means, on=["ego", "partner"], how="left", maintain_order="left")


_COUNTS = (
    pl.len().cast(pl.Int64).alias("episodes"),
    pl.col("nonfinite").sum().cast(pl.Int64),
)


def _means(names: Sequence[str]) -> list[pl.Expr]:
    return [pl.col(name).cast(pl.Float64).mean() for name in names]


def profile_table(record: Record) -> pl.DataFrame:
    """Return the performance profile of the evaluated side.

    The columns are threshold, share above it, and the band's low and high.
    """
    scores = record.returns.evaluated_side.scores
    thresholds = np.linspace(min(0.0, scores.min()), scores.max(), POINTS)
    low, high = profile_band(scores, thresholds) or (None, None)
    share = performance_profile(scores, thresholds)
    return pl.DataFrame(
        {"threshold": thresholds, "share": share, "low": low, "high": high},
        schema=dict.fromkeys(("threshold", "share", "low", "high"), pl.Float64),
    )


def crossplay_matrix(record: Record) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Return the matrix in long form, one row a pair, and its clustered order."""
    # Imported here because it loads SciPy, which an evaluation does not need.
    from evaluation.figures.clustering import clustered_order

    pairs = pair_table(record)
    return pairs, clustered_order(pairs)


def save_evaluation(
    record: Record,
    context: Context,
    *,
    include_own: bool = False,
    references: tuple[pl.DataFrame, pl.DataFrame] | None = None,
    met: MetPartners = NOTHING_KNOWN,
    notes: Sequence[str] = (),
    metrics: Mapping[str, InstalledMetric] | None = None,
) -> EvaluationSummary:
    """Write every table made from an evaluation's episodes, and its summary, into its folder.

    Args:
        record: The episodes and their folder.
        context: The run's metadata that is not in the episodes.
        include_own: Whether figures count partners that were trained with one of the egos.
        references: Episodes of the reference egos and the table of bounds, if they played.
        met: The egos' training partners.
        notes: More notes for readers.
        metrics: Metrics of installed packages, by name.

    Raises:
        ValueError: The egos met all partners, or all of the test side.
    """
    folder, table = record.folder, record.table
    left = left_out(table, met)
    check_new(dict(table.select("partner", "side").unique().rows()), left, include_own)
    uncounted = [] if include_own else left
    counted = record.without(uncounted)
    summary = summarise_evaluation(counted, context, metrics)
    all_notes = (*summary.notes, *met_notes(table, met, include_own), *notes)
    summary = dataclasses.replace(summary, notes=all_notes, met=met.summary(uncounted))
    tables.write_parquet(partner_table(record), folder / tables.PARTNERS_FILE)
    tables.write_parquet(profile_table(counted), folder / tables.PROFILE_FILE)
    written = [tables.PARTNERS_FILE, tables.PROFILE_FILE, tables.SUMMARY_FILE]
    if references is not None:
        played, bounds = references
        written += [tables.REFERENCES_FILE, tables.BOUNDS_FILE]
        tables.write_parquet(played, folder / tables.REFERENCES_FILE)
        tables.write_parquet(bounds, folder / tables.BOUNDS_FILE)
        earned, relative = summarise_references(counted, played, bounds)
        summary = dataclasses.replace(summary, references=earned, relative=relative)
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    tables.remove_derived(folder, but=written)  # drawn from these episodes with other options
    return summary


def save_crossplay(
    record: Record,
    context: Context,
    met: MetPartners = NOTHING_KNOWN,
    metrics: Mapping[str, InstalledMetric] | None = None,
) -> CrossPlaySummary:
    """Write pairs, their clustered order, the partners' strategies, and the summary."""
    from evaluation.figures.strategies import summarise_strategies

    folder, summary = record.folder, summarise_crossplay(record, context, metrics)
    summary = dataclasses.replace(summary, notes=(*summary.notes, *crossplay_notes(met)))
    written = [tables.PAIRS_FILE, tables.ORDER_FILE, tables.SUMMARY_FILE]
    pairs, order = crossplay_matrix(record)
    tables.write_parquet(pairs, folder / tables.PAIRS_FILE)
    if set(BEHAVIOUR) <= set(pairs.columns):
        tables.write_json(summarise_strategies(pairs), folder / tables.STRATEGIES_FILE)
        written.append(tables.STRATEGIES_FILE)
    tables.write_json(order, folder / tables.ORDER_FILE)
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    tables.remove_derived(folder, but=written)
    return summary
