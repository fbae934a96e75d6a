"""Comparing methods, the cost of a split, and how diverse a population is."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from assistax_base.statistics import score_matrix
from evaluation.figures.bootstrap import (
    RESAMPLES,
    Counts,
    Interval,
    draw_counts,
    generalises_to,
    interval,
    replicate_crossed,
)
from evaluation.figures.metrics import Difference, paired_difference
from evaluation.figures.strategies import best_responses, br_diversity
from tools.release_page.data import CrossPlayed

CHOICES = 100  # of teams, drawn at random
_TOLERANCE = 1e-10  # of the largest singular value; below it a direction counts as absent


@dataclasses.dataclass(frozen=True)
class Diverse:
    """How many directions behaviour and returns have, of all teams and of choices among them."""

    behaviour: float  # participation ratio of the features of best responses, at most one each
    returns: float  # effective rank of the cross-play matrix
    # Mean over choices of equally many teams, with their 2.5% and 97.5% quantiles.
    chosen_behaviour: Interval
    chosen_returns: Interval


@dataclasses.dataclass(frozen=True)
class Compared:
    """Two methods' difference, with its two-sided p and the same after Holm's correction."""

    difference: Difference
    p: float | None  # None if nothing was resampled
    adjusted: float | None


Comparison = dict[tuple[str, str], Compared]  # by the names of two methods


def compare(scores: Mapping[str, np.ndarray]) -> Comparison:
    """Compare every two methods by their returns [S, P] with the same partners."""
    differences = {
        (a, b): paired_difference(scores[a], scores[b])
        for a, b in itertools.combinations(scores, 2)
    }
    p = {
        pair: value
        for pair, difference in differences.items()
        if (value := two_sided(difference)) is not None
    }
    adjusted = dict(zip(p, holm(list(p.values())), strict=True))
    return {
        pair: Compared(difference, p.get(pair), adjusted.get(pair))
        for pair, difference in differences.items()
    }


def two_sided(difference: Difference) -> float | None:
    """Return a difference's p-value by its replicates; None if nothing was resampled.

    Twice the share of replicates on the rarer side of 0, ties counting one half, with one replicate
    added to either count, so that p is never 0.
    """
    if difference.p_positive is None:
        return None
    rarer = RESAMPLES * min(difference.p_positive, 1 - difference.p_positive)
    return min(1.0, 2 * (1 + rarer) / (1 + RESAMPLES))


def holm(p: Sequence[float]) -> list[float]:
    """Adjust p-values so that any false rejection among all of them is as rare as p says.

    Holm (1979): the k-th smallest of m counts m - k + 1 times, and never less than a smaller one.
    """
    values = np.asarray(p, float)
    order = np.argsort(values, kind="stable")
    times = np.arange(len(values), 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.maximum.accumulate(times * values[order]).clip(max=1.0)
    return adjusted.tolist()


class SplitCost(NamedTuple):
    """What unseen partners cost."""

    lost: Interval  # mean return of the mirror less that of the other
    share: Interval | None  # of the mirror's; None where that is not surely above zero


def split_cost(mirror: np.ndarray, plain: np.ndarray, *, seed: int = 0) -> SplitCost:
    """Return what unseen partners cost, in return and as a share of the mirror's.

    The seeds of either are resampled apart, the partners together.

    Args:
        mirror: Returns [S, P] of robots that were trained with these test partners.
        plain: Returns [S', P] of robots that were trained with the training side, same partners.
        seed: Of the resamples.

    Raises:
        ValueError: They have different numbers of partners.
    """
    mirror, plain = score_matrix(mirror), score_matrix(plain)
    if mirror.shape[1] != plain.shape[1]:
        raise ValueError(
            f"the mirror has {mirror.shape[1]} partners and the other {plain.shape[1]}; give both "
            "the same partners"
        )
    rng = np.random.default_rng(seed)
    partners = draw_counts(mirror.shape[1], RESAMPLES, rng)
    to = generalises_to(max(len(mirror), len(plain)), mirror.shape[1])
    above, below = (
        replicate_crossed(
            scores, Counts(draw_counts(len(scores), RESAMPLES, rng), partners, None, to)
        )
        for scores in (mirror, plain)
    )
    count = above.n + below.n
    lost = Interval(above.mean - below.mean, interval(above.means - below.means, to), count, to)
    shares = interval(1 - below.means / np.where(above.means > 0, above.means, np.nan), to)
    # Without an interval although there were draws: in over 5% of them the mirror earned nothing.
    if above.mean <= 0 or (shares is None and lost.value_ci is not None):
        return SplitCost(lost, None)
    return SplitCost(lost, Interval(1 - below.mean / above.mean, shares, count, to))


def effective_rank(matrix: np.ndarray) -> float:
    """Return how many directions a matrix [R, C] has beside its rows' and columns' means.

    The exponential of the entropy of the singular values, divided by their sum, of the doubly
    centred matrix (Roy & Vetterli 2007); 0 where nothing is left of it.
    """
    rows, columns = matrix.mean(axis=1, keepdims=True), matrix.mean(axis=0, keepdims=True)
    values = np.linalg.svd(matrix - rows - columns + matrix.mean(), compute_uv=False)
    values = values[values > _TOLERANCE * max(np.abs(matrix).max(), values.max())]
    if not values.size:
        return 0.0
    shares = values / values.sum()
    return float(np.exp(-(shares * np.log(shares)).sum()))


def diversity(played: CrossPlayed, size: int, *, seed: int = 0) -> Diverse:
    """Return the diversity of a cross-play's teams, and of choices of `size` of them.

    Raises:
        ValueError: The cross-play has fewer teams.
    """
    matrix, teams = played.matrix, len(played.teams)
    if not 1 <= size <= teams:
        raise ValueError(f"size is {size}; the cross-play has {teams} teams")
    responses = best_responses(played.pairs)
    named = dict(played.pairs.select("partner", "partner_team").unique().rows())
    places = {named[partner]: place for place, partner in enumerate(responses.partners)}
    features = responses.features[[places[team] for team in played.teams]]
    rng = np.random.default_rng(seed)
    chosen = [rng.choice(teams, size, replace=False) for _ in range(CHOICES)]
    behaviour = np.array([br_diversity(features[i]).participation_ratio for i in chosen])
    returns = np.array([effective_rank(matrix[np.ix_(i, i)]) for i in chosen])
    return Diverse(
        br_diversity(features).participation_ratio,
        effective_rank(matrix),
        *(
            Interval(float(draws.mean()), interval(draws, "teams"), size, "teams")
            for draws in (behaviour, returns)
        ),
    )
