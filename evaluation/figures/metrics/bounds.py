"""Returns relative to what is possible with a partner.

Normalised return, BR-Prox, regret, coverage.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Num

from assistax_base.statistics import score_matrix
from evaluation.figures.bootstrap import (
    RESAMPLES,
    Estimate,
    Interval,
    crossed_counts,
    estimate,
    interval,
)


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Reference returns with each partner."""

    best: np.ndarray  # B [P], return of an estimated best response: a lower bound of the true one
    low: np.ndarray  # L [P], return of a poor ego, such as the zero action

    def __post_init__(self) -> None:
        object.__setattr__(self, "best", np.asarray(self.best, float))
        object.__setattr__(self, "low", np.asarray(self.low, float))
        if self.best.ndim != 1 or self.best.shape != self.low.shape:
            raise ValueError(
                f"best {self.best.shape} and low {self.low.shape} differ; give one of each for "
                "each partner"
            )
        if not np.isfinite(self.best).all() or not np.isfinite(self.low).all():
            raise ValueError("a bound is not finite; give finite returns")

    @property
    def scorable(self) -> Bool[np.ndarray, " P"]:
        """Partners with B > L.

        With the others every ego would score alike: they are left out.
        """
        return self.best > self.low


@dataclasses.dataclass(frozen=True, kw_only=True)
class Coverage(Interval):
    """Share of scorable partners with a normalised regret of at most epsilon."""

    epsilon: float


def normalised_return(scores: Num[np.ndarray, "S P"], bounds: Bounds) -> Float[np.ndarray, "S P"]:
    """X = (J - L) / (B - L) of scores, not clipped.

    NaN in the columns of unscorable partners.
    """
    span = np.where(bounds.scorable, bounds.best - bounds.low, np.nan)
    return (score_matrix(scores) - bounds.low) / span


def br_prox(scores: Num[np.ndarray, "S P"], bounds: Bounds) -> Estimate | None:
    """BR-Prox: min(1, (J - L) / (B - L)) over scores.

    ZSC-Eval (arXiv 2310.05208) has J / B; subtracting L makes it independent of a constant in the
    reward. None where no partner is scorable.
    """
    capped = np.minimum(normalised_return(scores, bounds), 1.0)[:, bounds.scorable]
    return estimate(capped) if capped.size else None


def regret(scores: Num[np.ndarray, "S P"], bounds: Bounds) -> Float[np.ndarray, " P"]:
    """B - J for each partner, J averaged over seeds.

    Negative where the ego is better than B.
    """
    return bounds.best - score_matrix(scores).mean(axis=0)


def coverage(
    scores: Num[np.ndarray, "S P"], bounds: Bounds, epsilon: float = 0.1
) -> Coverage | None:
    """Share of scorable partners whose normalised regret is at most epsilon.

    The normalised regret is (B - J) / (B - L). None where no partner is scorable.
    """
    regrets = 1.0 - normalised_return(scores, bounds)[:, bounds.scorable]
    if not regrets.size:
        return None
    seeds, partners = regrets.shape
    counts = crossed_counts(regrets.shape, False, RESAMPLES, seed=0)
    covered = (counts.seeds @ regrets / seeds <= epsilon) * counts.partners
    return Coverage(
        value=float((regrets.mean(axis=0) <= epsilon).mean()),
        value_ci=interval(covered.sum(axis=1) / partners, counts.generalises_to),
        n=regrets.size,
        generalises_to=counts.generalises_to,
        epsilon=epsilon,
    )
