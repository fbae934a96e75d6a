"""M_test, M_train and their gap, and the same by groups of partners."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from evaluation.bootstrap import (
    RESAMPLES,
    Draws,
    Estimate,
    Interval,
    draw_counts,
    generalises_to,
    interval,
    replicate_crossed,
)
from evaluation.statistics import score_matrix


@dataclasses.dataclass(frozen=True)
class ZeroShot:
    """M over the test and the training partners; None for a side that was not evaluated."""

    m_test: Estimate | None
    m_train: Estimate | None
    gap: Estimate | None  # m_train - m_test, the same resampled seeds on both sides


@dataclasses.dataclass(frozen=True)
class Fairness:
    """Spread of M over groups of partners, by the mean."""

    worst: str  # group with the lowest mean
    best: str
    gap: Interval  # highest minus lowest mean; noise alone makes it positive


def zero_shot(
    scores: np.ndarray, sides: Sequence[str | None], *, resamples: int = RESAMPLES, seed: int = 0
) -> ZeroShot:
    """M(s) = mean over partners p of J[s, p], separately for the partners of each side.

    Args:
        scores: mean returns J [S, P].
        sides: "test", "train" or None (in neither) for each partner [P].
        resamples: number of bootstrap draws; `seed` makes them reproducible.
        seed: seed of the draws.
    """
    draws = {
        side: draw
        for side, draw in group_draws(scores, sides, resamples=resamples, seed=seed).items()
        if side in ("test", "train")
    }
    if not draws:
        raise ValueError("no partner is on the test or the train side; evaluate against a split")
    test, train = draws.get("test"), draws.get("train")
    gap = train - test if train and test else None
    return ZeroShot(*(draw.estimate() if draw else None for draw in (test, train, gap)))


def group_draws(
    scores: np.ndarray, groups: Sequence[str | None], *, resamples: int = RESAMPLES, seed: int = 0
) -> dict[str, Draws]:
    """Replicate mean and IQM of scores [S, P] for each group of partners [P], in order of names.

    None is left out.

    Seeds are resampled once for all groups, partners within each group: groups subtract to paired
    differences.
    """
    scores = score_matrix(scores)
    if len(groups) != scores.shape[1]:
        raise ValueError(
            f"there are {len(groups)} groups for {scores.shape[1]} partners; give one for each "
            "partner"
        )
    labels, rng = np.array(groups, object), np.random.default_rng(seed)
    seed_counts = draw_counts(len(scores), resamples, rng)
    draws = {}
    for name in sorted({group for group in groups if group is not None}):
        part = scores[:, labels == name]
        counts = draw_counts(part.shape[1], resamples, rng)
        draws[name] = replicate_crossed(part, seed_counts, counts, generalises_to(part.shape))
    return draws


def fairness(draws: dict[str, Draws]) -> Fairness:
    """Compare groups by their mean.

    `gap = max_g M_g - min_g M_g`, taken anew in every draw for its interval.
    """
    if not draws:
        raise ValueError("there are no groups of partners; at least one is needed")
    means = {name: draw.mean for name, draw in draws.items()}
    worst, best = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
    replicates = np.stack([draw.means for draw in draws.values()])
    to = max((draw.generalises_to for draw in draws.values()), key=len)
    n = sum(draw.n for draw in draws.values())
    ci = interval(replicates.max(axis=0) - replicates.min(axis=0), to) if len(draws) > 1 else None
    return Fairness(worst, best, Interval(means[best] - means[worst], ci, n, to))
