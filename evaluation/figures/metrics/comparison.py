"""Comparing methods or egos: paired differences and the stability of a ranking."""

import dataclasses

import numpy as np
from jaxtyping import Num

from assistax_base.statistics import returns_of, score_matrix
from evaluation.figures.bootstrap import (
    NOTHING,
    RESAMPLES,
    Counts,
    Estimate,
    draw_counts,
    draw_starts,
    generalises_to,
    replicate_crossed,
)


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
    a: np.ndarray, b: np.ndarray, *, common_starts: bool = False, seed: int = 0
) -> Difference:
    """Return the difference of returns a [S, P, K] and b [S', P, K], or scores [S, P], [S', P].

    Seeds of both methods, the partners and, if they are common to all, the starts are resampled.
    Both methods met the same partners in the same episodes, so effects of a start cancel.
    """
    a, b = returns_of(a), returns_of(b)
    if a.shape[1:] != b.shape[1:]:
        x, y = (" x ".join(map(str, scores.shape[1:])) for scores in (a, b))
        axes = "partners x episodes" if a.ndim == b.ndim == 3 else "partners"
        raise ValueError(f"a has {x} {axes} and b has {y}; give both the same")
    rng = np.random.default_rng(seed)
    a_counts, b_counts, partners = (
        draw_counts(n, RESAMPLES, rng) for n in (len(a), len(b), a.shape[1])
    )
    starts = draw_starts(a.shape, common_starts, RESAMPLES, rng)
    units = 1 if starts is None else starts.shape[1]
    to = generalises_to(min(len(a), len(b)), a.shape[1], units)
    draws = replicate_crossed(a, Counts(a_counts, partners, starts, to)) - replicate_crossed(
        b, Counts(b_counts, partners, starts, to)
    )
    difference = (a.mean(axis=0) - b.mean(axis=0)).reshape(a.shape[1], -1).mean(axis=1)
    return Difference(
        **vars(draws.estimate()),
        means=(float(a.mean()), float(b.mean())),
        seeds=(len(a), len(b)),
        partners=a.shape[1],
        p_positive=_share_positive(draws.means) if to != NOTHING else None,
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


def _share_positive(values: np.ndarray) -> float:
    return float(np.mean((values > 0) + 0.5 * (values == 0)))
