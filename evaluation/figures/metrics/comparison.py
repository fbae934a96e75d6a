"""Comparing methods or egos: paired differences and the stability of a ranking."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Num

from assistax_base.statistics import returns_of, score_matrix
from evaluation.figures.bootstrap import (
    NOTHING,
    RESAMPLES,
    Counts,
    Estimate,
    Interval,
    draw_counts,
    draw_starts,
    generalises_to,
    interval,
    replicate_crossed,
)
from evaluation.figures.metrics.generalisation import mean_of_draws


@dataclasses.dataclass(frozen=True)
class Difference(Estimate):
    """Method a minus method b with the same partners and episode keys: paired differences."""

    means: tuple[float, float]  # of either method over these partners
    seeds: tuple[int, int]  # of either method
    partners: int
    # Share of replicates in which a's mean is above b's; None if nothing was resampled.
    p_positive: float | None
    # Share of partners with which a's mean is above b's, ties counting one half.
    partners_better: float


@dataclasses.dataclass(frozen=True)
class Stability:
    """Kendall's tau between rankings of the egos on random halves of the partners."""

    tau: float  # mean over the halvings
    # 2.5% and 97.5% quantiles over the halvings: a spread, not a confidence interval.
    spread: tuple[float, float]
    halvings: int


def paired_difference(
    a: np.ndarray,
    b: np.ndarray,
    groups: Sequence[str] | None = None,
    *,
    common_starts: bool = False,
    seed: int = 0,
) -> Difference:
    """Return the difference of returns a [S, P, K] and b [S', P, K], or scores [S, P], [S', P].

    Seeds of both methods, the partners and, if they are common to all, the starts are resampled.
    Both methods met the same partners in the same episodes, so effects of a start cancel. If
    `groups` has the group of each partner [P], means are the means of the groups' means, and
    partners are resampled within their group.
    """
    a, b = returns_of(a), returns_of(b)
    if a.shape[1:] != b.shape[1:]:
        x, y = (" x ".join(map(str, scores.shape[1:])) for scores in (a, b))
        axes = "partners x episodes" if a.ndim == b.ndim == 3 else "partners"
        raise ValueError(f"a has {x} {axes} and b has {y}; give both the same")
    rng = np.random.default_rng(seed)
    a_counts, b_counts = (draw_counts(n, RESAMPLES, rng) for n in (len(a), len(b)))
    named = np.array(groups or [""] * a.shape[1])
    of_groups, means, starts = [], [], None
    for group in sorted(set(named.tolist())):
        x, y = (scores[:, named == group] for scores in (a, b))
        partners = draw_counts(x.shape[1], RESAMPLES, rng)
        if starts is None or not common_starts:
            starts = draw_starts(x.shape, common_starts, RESAMPLES, rng)
        units = 1 if starts is None else starts.shape[1]
        to = generalises_to(min(len(a), len(b)), x.shape[1], units)
        of_a, of_b = Counts(a_counts, partners, starts, to), Counts(b_counts, partners, starts, to)
        of_groups.append(replicate_crossed(x, of_a) - replicate_crossed(y, of_b))
        means.append((x.mean(), y.mean()))
    draws = mean_of_draws(of_groups)
    difference = (a.mean(axis=0) - b.mean(axis=0)).reshape(a.shape[1], -1).mean(axis=1)
    return Difference(
        **vars(draws.estimate()),
        means=tuple(np.mean(means, axis=0).tolist()),
        seeds=(len(a), len(b)),
        partners=a.shape[1],
        p_positive=_share_positive(draws.means) if draws.generalises_to != NOTHING else None,
        partners_better=_share_positive(difference),
    )


def rank_stability(
    scores: Num[np.ndarray, "E P"], *, halvings: int = 200, seed: int = 0
) -> Stability:
    """Return Kendall's tau-b of the egos' ranking, by mean, between random halves of partners.

    A halving on which all egos tie has no ranking and is left out.
    """
    from scipy import stats  # half a second, hence not at every start

    scores = score_matrix(scores)
    egos, partners = scores.shape
    if egos < 2 or partners < 2:
        raise ValueError(
            f"there are {egos} egos and {partners} partners; a ranking on halves needs 2 or more "
            "of both"
        )
    rng = np.random.default_rng(seed)
    taus = []
    for _ in range(halvings):
        order = rng.permutation(partners)
        first, second = (scores[:, half].mean(axis=1) for half in np.array_split(order, 2))
        if np.ptp(first) > 0 and np.ptp(second) > 0:
            taus.append(stats.kendalltau(first, second).statistic)
    if not taus:
        raise ValueError("all egos have the same scores; there is no ranking to compare")
    low, high = np.quantile(taus, (0.025, 0.975))
    return Stability(float(np.mean(taus)), (float(low), float(high)), len(taus))


@dataclasses.dataclass(frozen=True)
class Agreement:
    """Kendall's tau-b between the rankings of R egos with partners of two kinds."""

    tau: Interval  # its `n` is the number of egos
    places: tuple[tuple[float, ...], tuple[float, ...]]  # of each ego with either kind, from 1


def rank_agreement(
    a: Num[np.ndarray, "R P"],
    b: Num[np.ndarray, "R Q"],
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Agreement | None:
    """Return how far two rankings of R egos, by their means over partners, agree.

    The interval resamples the partners of either kind, and no egos. With few egos it is wide, and
    its ends are among few values: three egos have the taus -1, -1/3, 1/3 and 1.

    Args:
        a: Scores with partners of one kind; NaN where an ego did not meet a partner.
        b: Scores of the same egos, in the same order, with those of the other kind.
        resamples: Number of resamples.
        seed: Seed of the resamples.

    Returns:
        The agreement; None if there are fewer than two egos, or all tie.
    """
    from scipy import stats  # half a second, hence not at every start

    if len(a) != len(b):
        raise ValueError(f"there are {len(a)} and {len(b)} egos; give scores of the same egos")
    rng = np.random.default_rng(seed)
    ones = [np.ones((1, scores.shape[1])) for scores in (a, b)]
    means = [_means(scores, one)[0] for scores, one in zip((a, b), ones, strict=True)]
    if len(a) < 2 or not all(np.ptp(mean) > 0 for mean in means):
        return None
    drawn = [
        _means(scores, draw_counts(scores.shape[1], resamples, rng)) if scores.shape[1] > 1 else
        np.broadcast_to(mean, (resamples, len(mean)))
        for scores, mean in zip((a, b), means, strict=True)
    ]  # fmt: skip
    several = max(a.shape[1], b.shape[1]) > 1
    to = "partners" if several else NOTHING
    tau = float(stats.kendalltau(*means).statistic)
    places = tuple(tuple(map(float, stats.rankdata(-mean))) for mean in means)
    return Agreement(Interval(tau, interval(_taus(*drawn), to), len(a), to), (places[0], places[1]))


def _means(scores: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the means [B, R] of egos over the partners that each met, for counts [B, P]."""
    met = np.isfinite(scores)
    sums, number = counts @ np.where(met, scores, 0.0).T, counts @ met.T.astype(float)
    return np.divide(sums, number, out=np.full_like(sums, np.nan), where=number > 0)


def _taus(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return Kendall's tau-b [B] of rows [B, R]; NaN where one is not defined."""
    first, second = np.triu_indices(a.shape[1], 1)
    x, y = (np.sign(means[:, first] - means[:, second]) for means in (a, b))
    size = np.sqrt((x * x).sum(axis=1) * (y * y).sum(axis=1))
    agreed = (x * y).sum(axis=1)
    return np.divide(agreed, size, out=np.full_like(size, np.nan), where=size > 0)


def _share_positive(values: np.ndarray) -> float:
    return float(np.mean((values > 0) + 0.5 * (values == 0)))
