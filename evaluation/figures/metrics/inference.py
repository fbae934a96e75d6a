"""Tests of a method against a baseline: p-values, Holm's correction, the detectable effect."""

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Num

from assistax_base.statistics import score_matrix
from evaluation.figures.metrics.generalisation import group_weights

POWER = 0.8  # of the effect that is called detectable


@dataclasses.dataclass(frozen=True)
class MeanTest:
    """A test of equal means of two methods over new seeds and new partners."""

    difference: float
    error: float  # standard error of the difference
    freedom: float  # degrees of freedom of Student's t
    p: float  # two-sided

    def detectable(self, alpha: float, power: float = POWER) -> float:
        """Return the true difference that such a test finds with this power, two-sided at alpha.

        (t(1 - alpha / 2) + t(power)) times the standard error.
        """
        from scipy import stats

        return float(stats.t.ppf((1 - alpha / 2, power), self.freedom).sum() * self.error)


def mean_test(
    a: Num[np.ndarray, "S P"], b: Num[np.ndarray, "T P"], groups: Sequence[str] | None = None
) -> MeanTest:
    """Return the test of the difference of two methods with the same partners and episodes.

    Seeds of either method are random, and so is how the methods differ with a partner. With MS the
    mean squares of seeds and of what is left beside seeds and partners, and V the variance of the
    partners' differences, the variance of the difference is estimated without bias by

        MS_seeds(a) / (S P) + MS_seeds(b) / (T P) + V / P - MS_left(a) / (S P) - MS_left(b) / (T P)

    and not taken below the parts of the seeds alone or of the partners alone. Its degrees of
    freedom are Satterthwaite's (1946). A method of one seed stands for itself: nothing is said of
    its new seeds, nor, with one partner, of new partners.

    Where each of G groups of partners counts the same, a mean is the mean of the groups' means. The
    parts of V and of MS_left are then sums over the groups, each of the group's own partners and
    divided by G^2. If a group has a single partner, weighted scores are tested as one group, whose
    variance is too wide.

    Args:
        a: Mean returns of a method's S seeds with P partners.
        b: Those of the other method's T seeds with the same.
        groups: The group of each partner [P], if each group counts the same.
    """
    from scipy import stats

    a, b = score_matrix(a), score_matrix(b)
    partners = a.shape[1]
    if partners != b.shape[1]:
        raise ValueError(f"a has {partners} partners and b has {b.shape[1]}; give both the same")
    if groups is not None and min(Counter(groups).values()) < 2:
        a, b, groups = a * group_weights(groups), b * group_weights(groups), None
    places: list[Any] = [slice(None)]
    if groups is not None:
        places = [np.flatnonzero(np.array(groups) == name) for name in sorted(set(groups))]
    seeds, left = [], []  # of either method: part of the variance, degrees of freedom
    for scores in (a, b):
        count = len(scores)
        if count < 2:
            continue
        means = np.mean([scores[:, place].mean(axis=1) for place in places], axis=0)
        seeds.append((means.var(ddof=1) / count, count - 1))
        left += [_left(scores[:, place], len(places)) for place in places if partners > 1]
    differences = [(a.mean(axis=0) - b.mean(axis=0))[place] for place in places]
    met = [
        (some.var(ddof=1) / (len(some) * len(places) ** 2), len(some) - 1)
        for some in differences
        if partners > 1
    ]
    parts = max(([*seeds, *met, *left], seeds, met), key=lambda some: sum(v for v, _ in some))
    mean = float(np.mean([some.mean() for some in differences]))
    variance = sum(value for value, _ in parts)
    if not variance > 0:
        return MeanTest(mean, 0.0, math.inf, 1.0 if mean == 0 or not parts else 0.0)
    freedom = variance**2 / sum(value**2 / count for value, count in parts)
    error = math.sqrt(variance)
    return MeanTest(mean, error, freedom, float(2 * stats.t.sf(abs(mean) / error, freedom)))


def _left(scores: np.ndarray, groups: int) -> tuple[float, int]:
    """Return the negative part of scores [S, P] of one of so many groups, and its freedom."""
    count, partners = scores.shape
    freedom = (count - 1) * (partners - 1)
    rest = scores - scores.mean(axis=1, keepdims=True) - scores.mean(axis=0)
    square = ((rest + scores.mean()) ** 2).sum() / freedom
    return -square / (count * partners * groups**2), freedom


def holm(p: Sequence[float]) -> tuple[float, ...]:
    """Return p-values adjusted for all of them together, by Holm (1979).

    With p in ascending order, that of place i of m becomes max over j <= i of (m - j) p_j, with j
    from 0, and 1 at most. Those at or below alpha are rejected with a chance of at most alpha that
    any is rejected wrongly.

    Examples:
        >>> holm((0.01, 0.04, 0.03))
        (0.03, 0.06, 0.06)
    """
    order = np.argsort(p, kind="stable")
    factors = len(p) - np.arange(len(p))
    raised = np.minimum(np.maximum.accumulate(factors * np.asarray(p, float)[order]), 1.0)
    adjusted = np.empty(len(p))
    adjusted[order] = raised
    return tuple(map(float, adjusted))
