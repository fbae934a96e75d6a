"""Returns relative to what is possible with a partner: normalised return, BR-Prox, regret, coverage."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from evaluation.bootstrap import (
    RESAMPLES,
    Estimate,
    Interval,
    cluster_counts,
    estimate,
    generalises_to,
    interval,
)
from evaluation.statistics import score_matrix


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Reference returns with each partner."""

    best: np.ndarray  # B [P], return of an estimated best response: a lower bound of the true one
    low: np.ndarray  # L [P], return of a poor ego, such as the zero action
    source: tuple[
        str, ...
    ]  # where each B comes from: "self-play", "cross-play", "trained best response", ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "best", np.asarray(self.best, float))
        object.__setattr__(self, "low", np.asarray(self.low, float))
        if not self.best.shape == self.low.shape == (len(self.source),):
            raise ValueError(
                f"best {self.best.shape}, low {self.low.shape} and {len(self.source)} sources "
                "differ; give one of each for each partner"
            )
        if not np.isfinite(self.best).all() or not np.isfinite(self.low).all():
            raise ValueError("a bound is not finite; give finite returns")

    @property
    def scorable(self) -> np.ndarray:
        """Partners [P] with B > L; with the others every ego would score alike, so they are left out and named."""
        return self.best > self.low


@dataclasses.dataclass(frozen=True)
class Scaled:
    """A figure of normalised returns and the partners it leaves out."""

    estimate: Estimate | None  # None when no partner is scorable
    unscorable: tuple[int, ...]  # indices of partners with B <= L


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Share of scorable partners with a normalised regret of at most epsilon, and the partners left out."""

    share: Interval | None
    unscorable: tuple[int, ...]


def best_in_matrix(
    scores: np.ndarray,
    row_teams: Sequence[str | None],
    column_teams: Sequence[str | None],
    low: np.ndarray,
) -> Bounds:
    """Take as B the best robot of a matrix [R, C] with each human; the maximum of noisy means is optimistic."""
    scores = score_matrix(scores)
    rows = scores.argmax(axis=0)
    own = [
        row_teams[row] is not None and row_teams[row] == team
        for row, team in zip(rows, column_teams, strict=True)
    ]
    return Bounds(
        scores.max(axis=0), low, tuple("self-play" if is_own else "cross-play" for is_own in own)
    )


def normalised_return(scores: np.ndarray, bounds: Bounds) -> np.ndarray:
    """X = (J - L) / (B - L) of scores [S, P], not clipped; NaN in the columns of unscorable partners."""
    scores = score_matrix(scores)
    if scores.shape[1] != len(bounds.source):
        raise ValueError(
            f"there are {len(bounds.source)} bounds for {scores.shape[1]} partners; give one for "
            "each"
        )
    span = np.where(bounds.scorable, bounds.best - bounds.low, np.nan)
    return (scores - bounds.low) / span


def br_prox(
    scores: np.ndarray, bounds: Bounds, *, resamples: int = RESAMPLES, seed: int = 0
) -> Scaled:
    """BR-Prox: min(1, (J - L) / (B - L)) over scores [S, P]; its figure is the IQM (ZSC-Eval, arXiv 2310.05208).

    ZSC-Eval has J / B; subtracting L makes it independent of a constant in the reward.
    """
    capped = np.minimum(normalised_return(scores, bounds), 1.0)[:, bounds.scorable]
    figure = estimate(capped, resamples=resamples, seed=seed) if capped.size else None
    return Scaled(figure, _unscorable(bounds))


def regret(scores: np.ndarray, bounds: Bounds) -> np.ndarray:
    """B - J for each partner [P], J averaged over seeds; negative where the ego beats the estimated best response."""
    return bounds.best - score_matrix(scores).mean(axis=0)


def coverage(
    scores: np.ndarray,
    bounds: Bounds,
    epsilon: float = 0.1,
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Coverage:
    """Share of partners whose normalised regret (B - J) / (B - L) is at most epsilon, of scores [S, P]."""
    regrets = 1.0 - normalised_return(scores, bounds)[:, bounds.scorable]
    if not regrets.size:
        return Coverage(None, _unscorable(bounds))
    seed_counts, partner_counts = cluster_counts(regrets.shape, resamples, seed)
    seeds, partners = regrets.shape
    replicates = ((seed_counts @ regrets / seeds <= epsilon) * partner_counts).sum(
        axis=1
    ) / partners
    to = generalises_to((seeds, partners))
    share = Interval(
        float((regrets.mean(axis=0) <= epsilon).mean()), interval(replicates, to), regrets.size, to
    )
    return Coverage(share, _unscorable(bounds))


def _unscorable(bounds: Bounds) -> tuple[int, ...]:
    return tuple(int(index) for index in np.flatnonzero(~bounds.scorable))
