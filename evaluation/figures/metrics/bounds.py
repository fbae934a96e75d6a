"""Returns relative to a partner's bounds: normalised return, BR-Prox, regret, coverage."""

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
        """Mask of the partners with B > L; with the others, scores do not separate egos."""
        return self.best > self.low


@dataclasses.dataclass(frozen=True, kw_only=True)
class Coverage(Interval):
    """Share of scorable partners with a normalised regret of at most epsilon."""

    epsilon: float


def share_of_range(
    scores: Num[np.ndarray, "S P"], low: Num[np.ndarray, " P"], high: Num[np.ndarray, " P"]
) -> Interval | None:
    """Return the share of a range that scores reach: (mean of scores - low) / (mean of high - low).

    Its interval resamples seeds, and partners of numerator and denominator together, so that a
    partner with a wide range counts in both. If the range is not positive, return None.
    """
    scores, gain = score_matrix(scores), np.asarray(high, float) - np.asarray(low, float)
    if not gain.mean() > 0:
        return None
    counts = crossed_counts(scores.shape, False, RESAMPLES, seed=0)
    reached = ((counts.seeds @ (scores - low)) * counts.partners).sum(axis=1) / len(scores)
    ranges = counts.partners @ gain
    shares = np.divide(reached, ranges, out=np.full(RESAMPLES, np.nan), where=ranges > 0)
    to = counts.generalises_to
    value = float((scores - low).mean() / gain.mean())
    return Interval(value, interval(shares, to), scores.size, to)


def best_of_robots(returns: Num[np.ndarray, "E P K"]) -> Float[np.ndarray, " P"]:
    """Return the mean return of the best robot with each partner [P], by cross-validation.

    The robot is chosen on even episodes and valued on odd ones, and vice versa, because the maximum
    of noisy means is too high. With one episode it is the maximum.
    """
    returns = np.asarray(returns, float)
    if returns.shape[2] < 2:
        return returns.mean(axis=2).max(axis=0)
    halves = [returns[:, :, start::2].mean(axis=2) for start in (0, 1)]
    partners = np.arange(returns.shape[1])
    return np.mean([halves[1 - i][halves[i].argmax(axis=0), partners] for i in (0, 1)], axis=0)


def normalised_return(scores: Num[np.ndarray, "S P"], bounds: Bounds) -> Float[np.ndarray, "S P"]:
    """Return X = (J - L) / (B - L) of scores, not clipped; NaN for unscorable partners."""
    span = np.where(bounds.scorable, bounds.best - bounds.low, np.nan)
    return (score_matrix(scores) - bounds.low) / span


def br_prox(scores: Num[np.ndarray, "S P"], bounds: Bounds) -> Estimate | None:
    """Return BR-Prox: the estimate of min(1, (J - L) / (B - L)) over scores.

    ZSC-Eval (arXiv 2310.05208) has J / B; subtracting L makes it independent of a constant in the
    reward. If no partner is scorable, return None.
    """
    capped = np.minimum(normalised_return(scores, bounds), 1.0)[:, bounds.scorable]
    return estimate(capped) if capped.size else None


def regret(scores: Num[np.ndarray, "S P"], bounds: Bounds) -> Float[np.ndarray, " P"]:
    """Return B - J for each partner, J averaged over seeds; negative if the ego exceeds B."""
    return bounds.best - score_matrix(scores).mean(axis=0)


def coverage(
    scores: Num[np.ndarray, "S P"], bounds: Bounds, epsilon: float = 0.1
) -> Coverage | None:
    """Return the share of scorable partners whose normalised regret is at most epsilon.

    The normalised regret is (B - J) / (B - L). If no partner is scorable, return None.
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
