"""Tests of a method against a baseline: p-values, Holm's correction, the detectable effect."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Num

from assistax_base.statistics import score_matrix

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


def mean_test(a: Num[np.ndarray, "S P"], b: Num[np.ndarray, "T P"]) -> MeanTest:
    """Return the test of the difference of two methods with the same partners and episodes.

    Seeds of either method are random, and so is how the methods differ with a partner. With MS the
    mean squares of seeds and of what is left beside seeds and partners, and V the variance of the
    partners' differences, the variance of the difference is estimated without bias by

        MS_seeds(a) / (S P) + MS_seeds(b) / (T P) + V / P - MS_left(a) / (S P) - MS_left(b) / (T P)

    and not taken below the parts of the seeds alone or of the partners alone. Its degrees of
    freedom are Satterthwaite's (1946). A method of one seed stands for itself: nothing is said of
    its new seeds, nor, with one partner, of new partners.

    Args:
        a: Mean returns of a method's S seeds with P partners.
        b: Those of the other method's T seeds with the same.
    """
    from scipy import stats

    a, b = score_matrix(a), score_matrix(b)
    partners = a.shape[1]
    if partners != b.shape[1]:
        raise ValueError(f"a has {partners} partners and b has {b.shape[1]}; give both the same")
    seeds, left = [], []  # of either method: part of the variance, degrees of freedom
    for scores in (a, b):
        count = len(scores)
        if count < 2:
            continue
        seeds.append((scores.mean(axis=1).var(ddof=1) / count, count - 1))
        if partners > 1:
            freedom = (count - 1) * (partners - 1)
            rest = scores - scores.mean(axis=1, keepdims=True) - scores.mean(axis=0)
            square = ((rest + scores.mean()) ** 2).sum() / freedom
            left.append((-square / (count * partners), freedom))
    differences = a.mean(axis=0) - b.mean(axis=0)
    met = [(differences.var(ddof=1) / partners, partners - 1)] if partners > 1 else []
    parts = max(([*seeds, *met, *left], seeds, met), key=lambda some: sum(v for v, _ in some))
    mean, variance = float(differences.mean()), sum(value for value, _ in parts)
    if not variance > 0:
        return MeanTest(mean, 0.0, math.inf, 1.0 if mean == 0 or not parts else 0.0)
    freedom = variance**2 / sum(value**2 / count for value, count in parts)
    error = math.sqrt(variance)
    return MeanTest(mean, error, freedom, float(2 * stats.t.sf(abs(mean) / error, freedom)))


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
