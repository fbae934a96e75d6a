"""A folder's headline figure, and the verdict of a replay on it."""

import dataclasses
from collections.abc import Callable
from typing import Literal

import polars as pl

from assistax_envs.persons.rows import FAMILIES, OWN_FAMILY, OWN_PREFIX, TEAMS, group_of
from evaluation.figures.summary import CrossPlaySummary, EvaluationSummary

# same: every episode of the figure was replayed with the same bits.
# sampled: some episodes of the figure were replayed, all with the same bits.
# within noise: of another processor; a bias of at most `MOST_HIDDEN` of the figure can be hidden.
# cannot be told: of another processor; a larger bias can be hidden.
# differs: a figure or an episode differs from the job's.
Verdict = Literal["same", "sampled", "within noise", "cannot be told", "differs"]
MOST_HIDDEN = 0.05  # share of the figure


@dataclasses.dataclass(frozen=True)
class Headline:
    """The main figure of a folder: the mean return of some of its episodes.

    Attributes:
        name: Such as "M_test".
        value: The figure.
        rows: Filter of its episodes.
        groups: Filters of groups of these episodes, if the figure is the mean of their means.
    """

    name: str
    value: float
    rows: pl.Expr
    groups: tuple[pl.Expr, ...] = ()

    @property
    def means(self) -> tuple[pl.Expr, ...]:
        """Filters of the episodes of each mean of which the figure is the mean."""
        return self.groups or (self.rows,)

    def mean_bias(self, bias: Callable[[pl.Expr], float | None]) -> float | None:
        """Return the figure's bias by that of each of its means; None if one is unknown."""
        biases = [found for found in map(bias, self.means) if found is not None]
        return sum(biases) / len(biases) if len(biases) == len(self.means) else None


@dataclasses.dataclass(frozen=True)
class Reach:
    """Part of the headline figure that a replay covers."""

    played: int  # number of replayed tiles of the job
    tiles: int  # number of all tiles of the job
    episodes: int  # number of the figure's episodes that were not replayed
    hidden: float | None  # see `hidden_bias`; None if none of the episodes were replayed
    # Mean of the figure's replayed episodes, minus their mean in the folder.
    difference: float | None = None

    @property
    def found(self) -> float:
        """The chance that one changed tile is among the replayed tiles."""
        return self.played / self.tiles


def headline_of(summary: EvaluationSummary | CrossPlaySummary) -> Headline:
    """Return M of the evaluated side of an evaluation, or the cross-play mean of a cross-play.

    A cross-play with only co-trained pairs has the self-play mean.
    """
    if isinstance(summary, EvaluationSummary):
        figure = getattr(summary, f"m_{summary.side}")
        left_out = list(summary.met.left_out) if summary.met else []
        rows = (pl.col("side") == summary.side) & ~pl.col("partner").is_in(left_out)
        family, groups = pl.col("partner_algorithm").cast(pl.String), []
        own = family.str.starts_with(OWN_PREFIX)
        others = {OWN_FAMILY: own, TEAMS: ~(own | family.is_in(FAMILIES))}
        for group in summary.by_group:
            members = [name for name in FAMILIES if group_of(name) == group]
            groups.append(rows & others.get(group, family.is_in(members)))
        if figure is None:  # a group did not play
            values = [found.mean for found in summary.by_group.values()]
            return Headline("mean of groups", sum(values) / len(values), rows, tuple(groups))
        return Headline(f"M_{summary.side}", figure.mean, rows, tuple(groups))
    teams = (pl.col(f"{seat}_team").cast(pl.String) for seat in ("ego", "partner"))
    together = pl.Expr.eq(*teams).fill_null(value=False)
    if summary.cross_play is not None:
        return Headline("cross-play mean", summary.cross_play.mean, ~together)
    if summary.self_play is None:
        raise ValueError("the cross-play has no pair, so no figure of it can be checked")
    return Headline("self-play mean", summary.self_play.mean, together)


def hidden_share(headline: Headline, reach: Reach) -> float | None:
    """Return the hidden bias as a share of the figure; None if unknown, or if the figure is 0.

    The figure is the smaller of the folder's and the replayed one, because a forger raises the
    folder's.
    """
    least = min(abs(headline.value), abs(headline.value + (reach.difference or 0.0)))
    return None if reach.hidden is None or least == 0 else reach.hidden / least


def verdict_of(headline: Headline, reach: Reach, *, same_bits: bool) -> Verdict:
    """Return the verdict on a folder without problems."""
    if same_bits:
        return "sampled" if reach.episodes else "same"
    share = hidden_share(headline, reach)
    return "cannot be told" if share is None or share > MOST_HIDDEN else "within noise"
