"""Bounds of the return with each partner, and figures relative to them.

A partner's low bound L is the return of the zero action. Its best return B is the highest known
one, of its own robot or of another's in a cross-play. `evaluation.play.baselines` plays the
episodes.
"""

import dataclasses

import numpy as np
import polars as pl

from evaluation.figures.bootstrap import Estimate, estimate
from evaluation.figures.metrics import (
    Bounds,
    Coverage,
    br_prox,
    coverage,
    estimate_of,
    normalised_return,
    regret,
)
from evaluation.record.record import Record

COLUMN = "reference"  # what an episode of the table of references is: an ego, SELF_PLAY, PASSIVE
# Ids in the episode table: of untrained egos, and of the passive partner.
ZERO, RANDOM, SCRIPT, PASSIVE = "zero-action", "uniform-random", "script", "passive-human"
SELF_PLAY, CROSS_PLAY, NONE = "self-play", "cross-play", "none"  # sources of a best response
REFERENCE_ROWS = (ZERO, RANDOM, SCRIPT, SELF_PLAY)  # that stand beside methods on a board


@dataclasses.dataclass(frozen=True)
class References:
    """Returns of reference egos with the same partners and episodes; None if not played."""

    zero_action: Estimate | None
    uniform_random: Estimate | None
    self_play: Estimate | None  # each partner's own robot
    best_response: Estimate | None  # the best robot known with each partner
    script: Estimate | None = None  # the task's script, which is not trained
    passive_human: Estimate | None = None  # these policies with a human that does nothing
    script_with_passive_human: Estimate | None = None


# As a league's rows stand: what looks at nothing, the policies themselves, what knows the partner.
REFERENCE_ORDER = (
    *("zero_action", "uniform_random", "script", "policies", "self_play", "best_response"),
    *("passive_human", "script_with_passive_human"),
)


@dataclasses.dataclass(frozen=True)
class WorstRegret:
    """The partner with which the egos are farthest below the best robot known."""

    partner: str
    regret: float


@dataclasses.dataclass(frozen=True)
class BoundsUsed:
    """Sources of the bounds of the relative figures."""

    low: str  # the ego whose returns are the low bound
    best: dict[str, int]  # partners by the source of their best response
    episodes: int  # of each low bound


@dataclasses.dataclass(frozen=True)
class Relative:
    """Figures on the scale from low bound to best response; None if no partner is scorable."""

    normalised_return: Estimate | None
    br_prox: Estimate | None
    regret: Estimate | None
    worst_regret: WorstRegret | None
    coverage: Coverage | None
    unscorable: tuple[str, ...]  # partners whose best response is at or below the low bound
    bounds: BoundsUsed


def bounds_table(references: pl.DataFrame, crossplay: pl.DataFrame | None = None) -> pl.DataFrame:
    """Return low and best return of each partner with their sources, one row a partner.

    `best` is the higher return of self-play and, if the table of pairs `crossplay` is given, of its
    best robot. It is a lower bound of the true best response, apart from the optimism of a maximum
    of noisy means. If there is neither, it is null.
    """
    means = references.group_by("partner", COLUMN, maintain_order=True).agg(
        pl.col("return").cast(pl.Float64).mean(),
        pl.col("ego").first(),
        pl.len().cast(pl.Int64).alias("episodes"),
    )
    low = means.filter(pl.col(COLUMN) == ZERO).select(
        "partner", low="return", low_episodes="episodes"
    )
    own = means.filter(pl.col(COLUMN) == SELF_PLAY)
    candidates = [own.select("partner", "return", "ego", "episodes", source=COLUMN)]
    if crossplay is not None:
        is_own = pl.col("ego_team") == pl.col("partner_team")
        source = pl.when(is_own).then(pl.lit(SELF_PLAY)).otherwise(pl.lit(CROSS_PLAY))
        candidates.append(crossplay.select("partner", "return", "ego", "episodes", source=source))
    best = (
        pl.concat(candidates)
        .sort("return", descending=True, maintain_order=True)
        .unique("partner", keep="first", maintain_order=True)
        .select("partner", "source", best="return", best_ego="ego", best_episodes="episodes")
    )
    table = low.join(best, on="partner", how="left", maintain_order="left")
    return table.with_columns(pl.col("source").fill_null(NONE), pl.lit(ZERO).alias("low_source"))


def summarise_references(
    record: Record, references: pl.DataFrame, bounds: pl.DataFrame
) -> tuple[References, Relative]:
    """Return the reference egos' returns, and the egos' figures relative to the bounds.

    All are with the partners of the evaluated side.

    Args:
        record: Record of the egos.
        references: The table of `evaluation.play.baselines.play_references`.
        bounds: The table of `bounds_table`.
    """
    returns = record.returns.evaluated_side
    partners = returns.partners.select("partner")
    bounds = partners.join(bounds, on="partner", how="left", maintain_order="left")
    on_side = references.join(partners, on="partner", how="semi", maintain_order="left")

    groups = returns.groups

    def figure(means: pl.Series) -> Estimate | None:
        of = groups if groups and means.len() == len(groups) else None  # as M_test
        return estimate_of(means.to_numpy()[None], of) if means.len() else None

    def returns_of(name: str) -> Estimate | None:
        played = on_side.filter(pl.col(COLUMN) == name).group_by("partner", maintain_order=True)
        means = played.agg(pl.col("return").cast(pl.Float64).mean())
        if groups and means.height == len(groups):
            means = partners.join(means, on="partner", maintain_order="left")
        return figure(means["return"])

    def alone(egos: pl.Expr) -> Estimate | None:
        rows = references.filter((pl.col("partner") == PASSIVE) & egos).sort("ego", "episode")
        shape = rows["ego"].n_unique(), 1, -1
        return estimate(rows["return"].to_numpy().reshape(shape)) if rows.height else None

    played = (returns_of(ZERO), returns_of(RANDOM), returns_of(SELF_PLAY))
    earned = References(
        *played,
        best_response=figure(bounds["best"].drop_nulls()),
        script=returns_of(SCRIPT),
        passive_human=alone(pl.col("ego").is_in(returns.egos["ego"].to_list())),
        script_with_passive_human=alone(pl.col("ego") == SCRIPT),
    )
    return earned, _relative(returns.scores, bounds)


def _relative(scores: np.ndarray, table: pl.DataFrame) -> Relative:
    """Return the relative figures of scores [S, P], whose partners are the rows of `table`."""
    low = table["low"].to_numpy()
    # Without a best response B = L, which makes a partner unscorable.
    bounds = Bounds(np.where(table["best"].is_null(), low, table["best"].fill_null(0.0)), low)
    scorable = bounds.scorable
    normalised = normalised_return(scores, bounds)[:, scorable]
    regrets = regret(scores, bounds)[scorable]
    scored = table["partner"].filter(pl.Series(scorable))
    sources = sorted(table["source"].value_counts().iter_rows())
    return Relative(
        normalised_return=estimate(normalised) if normalised.size else None,
        br_prox=br_prox(scores, bounds),
        regret=estimate(regrets[None]) if regrets.size else None,
        worst_regret=WorstRegret(scored[int(regrets.argmax())], float(regrets.max()))
        if regrets.size
        else None,
        coverage=coverage(scores, bounds),
        unscorable=tuple(table["partner"].filter(pl.Series(~scorable))),
        bounds=BoundsUsed(ZERO, dict(sources), int(table["low_episodes"][0])),
    )
