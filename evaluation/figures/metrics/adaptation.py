"""Adaptation: whether a robot does more of what a person likes more of.

The adaptation slope of a wish is the slope of log(done) on log(liked) over persons, by least
squares: 1 is perfect, 0 is no adaptation. What was done with a person is first averaged over its
episodes, in the logarithm.

The slope of a robot counts only if, on average over its persons, at least `CREDITED` of the touch
is within a factor 1.5 of what is liked. A person whom it never touched counts as 0 in this
average. A robot below that share gets no credit: its slope counts as 0, or as itself if that is
negative. So a robot that swings between half and double earns nothing, although its mean suits
everybody. The figure of a method is the mean over its robots. In its interval both persons and
robots are resampled, and each resample applies the rule anew.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from evaluation.figures.bootstrap import RESAMPLES, Interval, crossed_counts, interval

CREDITED = 0.6  # least share of touch within a factor 1.5, with which a robot's slope counts
FEWEST = 3  # persons that were touched
_SAME = 1e-3  # difference of logarithms below which two liked values are one


@dataclasses.dataclass(frozen=True)
class Adaptation:
    """Adaptation of the robots of a method to one wish of their persons."""

    slope: Interval  # its `n` is the number of pairs of robot and person with a touch
    plain: float | None  # the slope without the rule about the share within; None if undefined
    within: float  # mean share of touch within a factor 1.5 of what is liked
    done_to_liked: float  # geometric mean over pairs
    credited: int  # robots whose slope counts


def adaptation(
    liked: Float[np.ndarray, "S P K"],
    done: Float[np.ndarray, "S P K"],
    within: Float[np.ndarray, "S P K"],
    *,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Adaptation | None:
    """Return the adaptation of S robots to one wish of P persons in K episodes of each pair.

    Args:
        liked: What the person likes, above 0.
        done: What was done, above 0; NaN where the wish was never judged.
        within: Share of touch within a factor 1.5; NaN likewise.
        resamples: Number of resamples.
        seed: Seed of the resamples.

    Returns:
        The adaptation; None if fewer than three persons were touched, if all like the same, or if
        a partner likes something else in each episode.
    """
    wishes = np.log(liked)
    if np.ptp(wishes, axis=(0, 2)).max() > _SAME:
        return None
    x, pairs = wishes[0, :, 0], _Pairs.of(np.log(done), within)
    touched = pairs.touched.any(axis=0)
    if touched.sum() < FEWEST or np.ptp(x[touched]) <= _SAME:
        return None
    x = x - x[touched].mean()
    counts = crossed_counts(pairs.log_done.shape, False, resamples, seed)
    one = np.ones((1, len(x)))
    plain, share = pairs.slopes(x, one)[0], pairs.shares(one)[0]
    counted = np.isfinite(plain)
    slopes = _credited(pairs.slopes(x, counts.partners), pairs.shares(counts.partners))
    replicates = _mean_of_robots(slopes, counts.seeds)
    value = float(_credited(plain, share).mean())
    ends = interval(replicates, counts.generalises_to)
    off = (pairs.log_done - wishes[0, :, 0])[pairs.touched]
    return Adaptation(
        slope=Interval(value, ends, int(pairs.touched.sum()), counts.generalises_to),
        plain=float(plain[counted].mean()) if counted.any() else None,
        within=float(share.mean()),
        done_to_liked=float(np.exp(off.mean())),
        credited=int((share >= CREDITED).sum()),
    )


@dataclasses.dataclass(frozen=True)
class _Pairs:
    """What each robot did with each person, averaged over their episodes."""

    touched: np.ndarray  # [S, P] bool
    log_done: np.ndarray  # [S, P], 0 without a touch
    within: np.ndarray  # [S, P], 0 without a touch

    @classmethod
    def of(cls, log_done: np.ndarray, within: np.ndarray) -> "_Pairs":
        """Return the means of [S, P, K], in which episodes without a touch are NaN."""
        known = np.isfinite(log_done)
        episodes = np.maximum(known.sum(axis=2), 1)
        means = (
            np.where(known, values, 0.0).sum(axis=2) / episodes for values in (log_done, within)
        )
        return cls(np.asarray(known.any(axis=2)), *means)

    def slopes(self, x: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """Return the slope of each robot [B, S] for counts [B, P] of persons; NaN if undefined."""
        there = self.touched.astype(float)
        n, x_sum, xx = (counts @ (there * factor).T for factor in (np.ones_like(x), x, x * x))
        y_sum, xy = (counts @ (self.log_done * factor).T for factor in (np.ones_like(x), x))
        spread = n * xx - x_sum**2
        rise = n * xy - x_sum * y_sum
        return np.divide(rise, spread, out=np.full_like(rise, np.nan), where=spread > 1e-9)

    def shares(self, counts: np.ndarray) -> np.ndarray:
        """Return the mean share within of each robot [B, S] for counts [B, P] of persons."""
        return counts @ self.within.T / counts.sum(axis=1, keepdims=True)


def _credited(slopes: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Return the slopes that count; a slope that is not defined is none."""
    found = np.nan_to_num(slopes)
    return np.where(shares >= CREDITED, found, np.minimum(found, 0.0))


def _mean_of_robots(slopes: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Return the means [B] of slopes [B, S] by the robots' counts [B, S]."""
    return (slopes * counts).sum(axis=1) / counts.sum(axis=1)
