"""From an episode table to the objects that `evaluate --json` and `crossplay --json` print, and to their folder."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import polars as pl

from evaluation import tables
from evaluation.bootstrap import Estimate, estimate, profile_band
from evaluation.clustering import cluster_profiles, cluster_teams
from evaluation.metrics import (
    Traits,
    cross_play,
    cvar_crossfit,
    fairness,
    group_draws,
    paired_difference,
    rank_stability,
    worst_partner,
    zero_shot,
)
from evaluation.statistics import performance_profile
from evaluation.strategies import summarise_strategies
from evaluation.tables import Block, dense_block

# Seeds, partners or teams; with fewer, intervals cover too little (see
# `evaluation.bootstrap.estimate`).
ENOUGH = 16


class SplitIdentity(Protocol):
    """What a summary says of a split."""

    @property
    def id(self) -> str: ...
    @property
    def sha256(self) -> str: ...


def summarise_evaluation(
    table: pl.DataFrame,
    *,
    task: str,
    split: SplitIdentity | Mapping[str, Any] | None,
    release: str | None,
    env_version: int,
    backend: str,
    env_steps_per_second: float | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Summarise an evaluation; all egos of the table are seeds of one method.

    `by_algorithm`, `by_disability`, `fairness`, `worst_partner` and `cvar_10` are about the
    partners of `side`: the test partners, or the training partners if only those were played.

    Raises:
        ValueError: the table is malformed or incomplete, or none of its partners is on a side of
            the split.
    """
    block = dense_block(table)
    sides = block.partners["side"].to_list()
    figures = zero_shot(block.scores, sides, seed=seed)
    side = "test" if figures.test else "train"
    focus = _on_side(block, side)
    by_disability = group_draws(
        focus.scores, focus.partners["partner_disability"].to_list(), seed=seed
    )
    by_algorithm = group_draws(
        focus.scores, focus.partners["partner_algorithm"].to_list(), seed=seed
    )
    return {
        "task": task,
        "split": _split(split),
        "m_test": _json(figures.test),
        "m_train": _json(figures.train),
        "gap": _json(figures.gap),
        "side": side,
        "by_algorithm": {name: draws.estimate().to_json() for name, draws in by_algorithm.items()},
        "by_disability": {
            name: draws.estimate().to_json() for name, draws in by_disability.items()
        },
        "fairness": _fairness(by_disability),
        "worst_partner": _worst_partner(focus),
        "cvar_10": cvar_crossfit(focus.returns, 0.1, seed=seed).to_json()
        if focus.returns.shape[2] > 1
        else None,
        "egos": block.egos["ego"].to_list(),
        "partners": {name: sides.count(name) for name in tables.SIDES},
        **_origin(block, release, env_version, backend, env_steps_per_second),
        "notes": [*_seed_notes(block.egos.height), *_group_notes(focus), *_episode_notes(block)],
    }


def summarise_crossplay(
    table: pl.DataFrame,
    *,
    task: str,
    release: str | None,
    env_version: int,
    backend: str,
    split: SplitIdentity | Mapping[str, Any] | None = None,
    env_steps_per_second: float | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Summarise a matrix of egos by partners: self-play, cross-play and their gaps, resampling whole teams."""
    block = dense_block(table)
    figures = cross_play(
        block.scores, _traits(block.egos, "ego"), _traits(block.partners, "partner"), seed=seed
    )
    means = block.scores.mean(axis=1)
    return {
        "task": task,
        "split": _split(split),
        "self_play": _json(figures.self_play),
        "cross_play": _json(figures.cross_play),
        "gap": _json(figures.gap),
        "relative_gap": figures.relative_gap.to_json() if figures.relative_gap else None,
        "within_algorithm": _json(figures.within_algorithm),
        "across_algorithms": _json(figures.across_algorithms),
        "within_disability": _json(figures.within_disability),
        "across_disabilities": _json(figures.across_disabilities),
        "best_ego": {"ego": block.egos["ego"][int(means.argmax())], "mean": float(means.max())},
        "rank_stability": _rank_stability(block.scores, seed),
        "egos": block.egos.height,
        "partners": block.partners.height,
        **_origin(block, release, env_version, backend, env_steps_per_second),
        "notes": [*_team_notes(block), *_episode_notes(block)],
    }


def summarise_comparison(a: pl.DataFrame, b: pl.DataFrame, *, seed: int = 0) -> dict[str, Any]:
    """Summarise method a minus method b, two tables over the same partners and episode keys, on their common sides."""
    first, second = dense_block(a), dense_block(b)
    if not first.partners.equals(second.partners):
        raise ValueError(
            "the two tables have different partners; evaluate both methods against the same split"
        )
    if first.keys is None or second.keys is None or not np.array_equal(first.keys, second.keys):
        raise ValueError(
            "the two tables have different episode keys; evaluate both with the same seed and "
            "episodes"
        )
    summary: dict[str, Any] = {}
    for side in tables.SIDES:
        mask = (first.partners["side"] == side).fill_null(False).to_numpy()
        if mask.any():
            difference = paired_difference(first.scores[:, mask], second.scores[:, mask], seed=seed)
            summary[side] = {
                **difference.estimate.to_json(),
                "p_positive": difference.p_positive,
                "partners_better": difference.partners_better,
            }
    if not summary:
        raise ValueError(
            "no partner is on the test or the train side; evaluate both methods against a split"
        )
    egos = min(first.egos.height, second.egos.height)
    return {
        **summary,
        "notes": [*_seed_notes(egos), *_episode_notes(first), *_episode_notes(second)],
    }


def partner_table(table: pl.DataFrame, *, seed: int = 0) -> pl.DataFrame:
    """Average over egos and episodes: one row a partner, `return_low` and `return_high` its mean's 95% over seeds."""
    block = dense_block(table)
    measures = ("success", "force_mean", "force_peak")
    means = table.group_by("partner").agg(
        *(pl.col(name).cast(pl.Float64).mean() for name in measures),
        pl.len().cast(pl.Int64).alias("episodes"),
        pl.col("nonfinite").sum().cast(pl.Int64),
    )
    columns = [estimate(column, seed=seed) for column in block.scores.T]
    returns = pl.DataFrame(
        {
            "partner": block.partners["partner"],
            "return": [figure.mean for figure in columns],
            "return_low": [figure.mean_ci[0] if figure.mean_ci else None for figure in columns],
            "return_high": [figure.mean_ci[1] if figure.mean_ci else None for figure in columns],
        },
        schema_overrides={"return_low": pl.Float64, "return_high": pl.Float64},
    )
    described = block.partners.join(returns, on="partner", maintain_order="left")
    return described.join(means, on="partner", maintain_order="left")


def profile_table(table: pl.DataFrame, *, points: int = 101, seed: int = 0) -> pl.DataFrame:
    """Performance profile over ego x partner pairs of the evaluated side: threshold, share above it, low, high."""
    block = dense_block(table)
    block = _on_side(block, "test" if "test" in block.partners["side"] else "train")
    thresholds = np.linspace(min(0.0, block.scores.min()), block.scores.max(), points)
    band = profile_band(block.scores, thresholds, seed=seed)
    low, high = band if band else (None, None)
    return pl.DataFrame(
        {
            "threshold": thresholds,
            "share": performance_profile(block.scores, thresholds),
            "low": low,
            "high": high,
        },
        schema=dict.fromkeys(("threshold", "share", "low", "high"), pl.Float64),
    )


def crossplay_matrix(table: pl.DataFrame) -> tuple[pl.DataFrame, dict[str, Any]]:
    """Return the matrix in long form, one row a pair, and its clustered order.

    The order has `rows` and `columns`, clustered separately, and `teams`: one order for both axes,
    with self-play on the diagonal, or None unless both axes have the same teams.
    """
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
    if (
        None not in rows
        and len(set(rows)) == len(rows)
        and sorted(rows) == sorted(columns, key=str)
    ):
        square = scores[:, [columns.index(team) for team in rows]]
        order["teams"] = cluster_teams(square).to_json(rows)
    return tables.pair_table(table), order


def save_evaluation(folder: Path, table: pl.DataFrame, **context: Any) -> dict[str, Any]:
    """Write summary, partner table and performance profile beside the episodes; `context` as `summarise_evaluation`."""
    summary = summarise_evaluation(table, **context)
    tables.write_parquet(partner_table(table), folder / tables.PARTNERS_FILE)
    tables.write_parquet(profile_table(table), folder / tables.PROFILE_FILE)
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    return summary


def save_crossplay(folder: Path, table: pl.DataFrame, **context: Any) -> dict[str, Any]:
    """Write summary, matrix, clustered order and strategies beside the episodes; `context` as `summarise_crossplay`."""
    summary = summarise_crossplay(table, **context)
    pairs, order = crossplay_matrix(table)
    tables.write_parquet(pairs, folder / tables.PAIRS_FILE)
    if set(tables.BEHAVIOUR) <= set(pairs.columns):
        tables.write_json(summarise_strategies(pairs), folder / tables.STRATEGIES_FILE)
    tables.write_json(order, folder / tables.ORDER_FILE)
    tables.write_json(summary, folder / tables.SUMMARY_FILE)
    return summary


def _json(figure: Estimate | None) -> dict[str, Any] | None:
    return figure.to_json() if figure else None


def _split(split: SplitIdentity | Mapping[str, Any] | None) -> dict[str, str] | None:
    if split is None:
        return None
    if isinstance(split, Mapping):
        return {"id": split["id"], "sha256": split["sha256"]}
    return {"id": split.id, "sha256": split.sha256}


def _origin(
    block: Block,
    release: str | None,
    env_version: int,
    backend: str,
    env_steps_per_second: float | None,
) -> dict[str, Any]:
    return {
        "episodes": block.returns.size,
        "episodes_per_pair": block.returns.shape[2],
        "nonfinite": int(block.nonfinite.sum()),
        "env_steps_per_second": env_steps_per_second,
        "release": release,
        "env_version": env_version,
        "backend": backend,
    }


def _on_side(block: Block, side: str) -> Block:
    return block.select_partners((block.partners["side"] == side).fill_null(False).to_numpy())


def _traits(policies: pl.DataFrame, seat: str) -> Traits:
    return Traits(
        *(policies[f"{seat}_{name}"].to_list() for name in ("team", "algorithm", "disability"))
    )


def _fairness(draws: dict[str, Any]) -> dict[str, Any] | None:
    if len(draws) < 2:
        return None
    spread = fairness(draws)
    return {"worst": spread.worst, "best": spread.best, "gap": spread.gap.to_json()}


def _worst_partner(block: Block) -> dict[str, Any]:
    worst = worst_partner(block.returns)
    partner = block.partners.row(worst.index, named=True)
    return {
        "partner": partner["partner"],
        "algorithm": partner["partner_algorithm"],
        "disability": partner["partner_disability"],
        "mean": worst.mean,
        "crossfit": worst.crossfit,
    }


def _rank_stability(scores: np.ndarray, seed: int) -> dict[str, Any] | None:
    if min(scores.shape) < 2 or not np.ptp(scores.mean(axis=1)):
        return None
    stability = rank_stability(scores, seed=seed)
    return {"tau": stability.tau, "spread": list(stability.spread), "halvings": stability.halvings}


def _seed_notes(egos: int) -> list[str]:
    if egos == 1:
        return ["one ego: intervals speak about new partners, not about new training seeds"]
    if egos < ENOUGH:
        return [f"{egos} seeds: intervals over fewer than {ENOUGH} seeds are too narrow"]
    return []


def _group_notes(block: Block) -> list[str]:
    counts = [Counter(block.partners[f"partner_{trait}"]) for trait in ("algorithm", "disability")]
    smallest = min(count for groups in counts for count in groups.values())
    if smallest >= ENOUGH:
        return []
    return [
        f"groups of partners have as few as {smallest}: intervals over fewer than {ENOUGH} "
        "partners are too narrow"
    ]


def _team_notes(block: Block) -> list[str]:
    units = min(block.egos.height, block.partners.height)
    return (
        [f"{units} teams: intervals over fewer than {ENOUGH} are too narrow"]
        if units < ENOUGH
        else []
    )


def _episode_notes(block: Block) -> Sequence[str]:
    broken = int(block.nonfinite.sum())
    notes = []
    if broken:
        notes.append(
            f"{broken} of {block.returns.size} episodes became non-finite and earn 0 from then on; "
            "they count"
        )
    if block.keys is None:
        notes.append("pairs played different episode keys: their differences are not paired")
    return notes
