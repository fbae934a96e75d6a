"""A folder's headline figure, and the verdict of a replay on it."""

import dataclasses
from typing import Literal

import polars as pl

from evaluation.figures.summary import CrossPlaySummary, EvaluationSummary

# same: every episode of the figure was played, and gives the same bits.
# sampled: so do those that were played; others were not.
# within noise: of another processor, and no more than `MOST_HIDDEN` of the figure can be hidden.
# cannot be told: of another processor, and more can be.
# differs: some figure or episode is not what the job gives.
Verdict = Literal["same", "sampled", "within noise", "cannot be told", "differs"]
MOST_HIDDEN = 0.05  # of the figure


@dataclasses.dataclass(frozen=True)
class Headline:
    """The figure that a folder is quoted by."""

    name: str
    value: float
    rows: pl.Expr  # of the episode table, whose mean return it is


@dataclasses.dataclass(frozen=True)
class Reach:
    """How much of the headline figure a replay reached."""

    played: int  # tiles of the job
    tiles: int
    episodes: int  # of the figure, that were not played
    hidden: float | None  # see `hidden_bias`; None where none of its episodes were played
    difference: float | None = None  # of the figure, found less kept, in those that were played

    @property
    def found(self) -> float:
        """The chance that a tile which somebody changed is among those that were played."""
        return self.played / self.tiles


def headline_of(summary: EvaluationSummary | CrossPlaySummary) -> Headline:
    """Return M of the evaluated side, or the mean of the pairs that did not train together."""
    if isinstance(summary, EvaluationSummary):
        figure = getattr(summary, f"m_{summary.side}")
        left_out = list(summary.met.left_out) if summary.met else []
        rows = (pl.col("side") == summary.side) & ~pl.col("partner").is_in(left_out)
        return Headline(f"M_{summary.side}", figure.mean, rows)
    teams = (pl.col(f"{seat}_team").cast(pl.String) for seat in ("ego", "partner"))
    together = pl.Expr.eq(*teams).fill_null(value=False)
    if summary.cross_play is not None:
        return Headline("cross-play mean", summary.cross_play.mean, ~together)
    if summary.self_play is None:
        raise ValueError("the cross-play has no pair, so no figure of it can be checked")
    return Headline("self-play mean", summary.self_play.mean, together)


def hidden_share(headline: Headline, reach: Reach) -> float | None:
    """Return the hidden part as a share of the figure; None if unknown, or if the figure is 0.

    The figure is the smaller of the folder's and the one found here: a forger raises the first.
    """
    least = min(abs(headline.value), abs(headline.value + (reach.difference or 0.0)))
    return None if reach.hidden is None or least == 0 else reach.hidden / least


def verdict_of(headline: Headline, reach: Reach, *, same_bits: bool) -> Verdict:
    """Return the verdict on a folder in which nothing was found that its job does not give."""
    if same_bits:
        return "sampled" if reach.episodes else "same"
    share = hidden_share(headline, reach)
    return "cannot be told" if share is None or share > MOST_HIDDEN else "within noise"
