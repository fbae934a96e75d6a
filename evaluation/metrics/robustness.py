"""The lower tail over partners, chosen on half of the episodes and valued on the other half."""

import dataclasses

import numpy as np

from evaluation.bootstrap import RESAMPLES, Interval, cluster_counts, generalises_to, interval
from evaluation.statistics import tail_weights


@dataclasses.dataclass(frozen=True)
class WorstPartner:
    """The partner with the lowest mean return."""

    index: int  # along the axis of partners
    mean: float  # over seeds and episodes; the minimum of noisy means is too low
    crossfit: (
        float | None
    )  # chosen on even episodes and valued on odd ones, and the reverse; None with one episode


def worst_partner(returns: np.ndarray) -> WorstPartner:
    """Find the worst partner of returns [S, P, K]."""
    returns = _returns(returns)
    means = returns.mean(axis=(0, 2))
    crossfit = None
    if returns.shape[2] > 1:
        even, odd = (half.mean(axis=0) for half in _halves(returns))
        crossfit = float((odd[even.argmin()] + even[odd.argmin()]) / 2)
    return WorstPartner(int(means.argmin()), float(means.min()), crossfit)


def cvar_crossfit(
    returns: np.ndarray, alpha: float = 0.1, *, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """CVaR_alpha: mean of the lowest share alpha of partner means, of returns [S, P, K].

    The tail is chosen on even episodes and valued on odd ones, and the other way round, because the
    lowest of noisy means are low by chance too; the boundary partner counts with the fraction that
    is left.
    """
    returns = _returns(returns)
    if returns.shape[2] < 2:
        raise ValueError(
            "CVaR needs 2 or more episodes a pair: one half chooses the tail and the other values "
            "it"
        )
    seeds, partners, _ = returns.shape
    even, odd = _halves(returns)

    def evaluate(seed_counts: np.ndarray, partner_counts: np.ndarray) -> np.ndarray:
        means = [seed_counts @ half / seeds for half in (even, odd)]
        tails = [
            (tail_weights(a, partner_counts, alpha) * b).sum(axis=1)
            for a, b in (means, reversed(means))
        ]
        return (tails[0] + tails[1]) / 2

    point = float(evaluate(np.ones((1, seeds)), np.ones((1, partners)))[0])
    to = generalises_to((seeds, partners))
    replicates = evaluate(*cluster_counts((seeds, partners), resamples, seed))
    return Interval(point, interval(replicates, to), seeds * partners, to)


def _halves(returns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return returns[:, :, 0::2].mean(axis=2), returns[:, :, 1::2].mean(axis=2)


def _returns(returns: np.ndarray) -> np.ndarray:
    returns = np.asarray(returns, float)
    if returns.ndim != 3 or not returns.size:
        raise ValueError(
            f"returns has shape {returns.shape}; expected [seeds, partners, episodes], none of "
            "them empty"
        )
    return returns
