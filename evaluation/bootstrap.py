"""Seeded percentile bootstrap, 95%: resamples of whole seeds, partners or teams as rows of counts.

An `Estimate` has two point figures, the mean and the IQM of all entries, each with an interval that
says whose it is; `generalises_to` says what was resampled, hence what the intervals speak about.
"""

import dataclasses
import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from evaluation.statistics import entries, iqm, mean, score_matrix, weighted_iqm, weighted_mean

RESAMPLES = 2000
NOTHING = "nothing"  # what an interval generalises to when there was nothing to resample
_ENTRIES_AT_ONCE = 1_000_000  # bounds the memory of a chunk of resamples


@dataclasses.dataclass(frozen=True)
class Estimate:
    """IQM and mean of one figure with their intervals."""

    mean: float  # mean of all entries
    iqm: float  # interquartile mean of all entries
    iqm_ci: tuple[float, float] | None  # None when there was nothing to resample
    mean_ci: tuple[float, float] | None
    n: int  # entries: ego x partner pairs
    generalises_to: str  # "seeds", "partners", "seeds and partners", "teams" or "nothing"


@dataclasses.dataclass(frozen=True)
class Interval:
    """A figure that is neither a mean nor an IQM, such as CVaR, with its interval."""

    value: float
    value_ci: tuple[float, float] | None  # None when there was nothing to resample
    n: int  # entries it was computed from
    generalises_to: str


@dataclasses.dataclass(frozen=True)
class Draws:
    """A figure and its replicates.

    Figures replicated on the same resamples subtract to a paired difference.
    """

    mean: float
    iqm: float
    means: np.ndarray  # [B] replicates of the mean; NaN where a resample held no entry
    iqms: np.ndarray  # [B] replicates of the IQM
    n: int
    generalises_to: str

    def __sub__(self, other: "Draws") -> "Draws":
        return Draws(
            mean=self.mean - other.mean,
            iqm=self.iqm - other.iqm,
            means=self.means - other.means,
            iqms=self.iqms - other.iqms,
            n=self.n + other.n,
            generalises_to=self.generalises_to,
        )

    def estimate(self) -> Estimate:
        """Close the replicates into intervals."""
        iqm_ci, mean_ci = (
            interval(replicates, self.generalises_to) for replicates in (self.iqms, self.means)
        )
        return Estimate(self.mean, self.iqm, iqm_ci, mean_ci, self.n, self.generalises_to)


def estimate(scores: np.ndarray, *, resamples: int = RESAMPLES, seed: int = 0) -> Estimate:
    """IQM and mean of scores [S, P], or [S] with one partner, with 95% bootstrap intervals.

    Whole seeds are resampled, then partners, because a seed's scores all come from one policy; of a
    single seed only the partners are resampled. Seeds resampled within each partner's column, as
    rliable does for independent runs on several tasks, would give intervals too narrow for one ego
    that meets every partner.

    Percentile intervals of few seeds are too narrow. Coverage, measured on normal data
    (2,000 repetitions, standard error 0.5%; 16 to 99 partners; either seed, partner and pair
    effects of one size, or mostly seed effects):

    | seeds    | 3       | 5       | 8       | 10      | 16      | 20      | 30      |
    | coverage | 74–87%  | 83–92%  | 88–94%  | 90–95%  | 92–95%  | 91–94%  | 93–95%  |

    A single seed with 16 or more partners: 92–95% for new partners of that seed. Where neither
    seeds nor partners differ beyond noise, the interval is too wide instead (98–100%).
    """
    scores = score_matrix(scores)
    counts = cluster_counts(scores.shape, resamples, seed)
    return replicate_crossed(scores, *counts, generalises_to(scores.shape)).estimate()


def profile_band(
    scores: np.ndarray, thresholds: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Pointwise cluster band (low [T], high [T]) of the performance profile of scores [S, P].

    None for one score.
    """
    scores = score_matrix(scores)
    if scores.size == 1:
        return None
    above = (scores[..., None] > np.asarray(thresholds, float)).astype(float)
    seed_counts, partner_counts = cluster_counts(scores.shape, RESAMPLES, seed=0)
    shares = (
        np.einsum("bs,spt,bp->bt", seed_counts, above, partner_counts, optimize=True) / scores.size
    )
    low, high = np.quantile(shares, (0.025, 0.975), axis=0)
    return low, high


def curve_band(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """IQM over seeds at each point of curves [S, T] with its pointwise band: (iqm, low, high).

    None for one seed.
    """
    values = score_matrix(values)
    if len(values) == 1:
        return None
    counts = draw_counts(len(values), RESAMPLES, np.random.default_rng(0))
    replicates = np.stack([weighted_iqm(column, counts) for column in values.T])
    low, high = np.quantile(replicates, (0.025, 0.975), axis=1)
    return np.array([iqm(column) for column in values.T]), low, high


def generalises_to(shape: tuple[int, int]) -> str:
    """Name what is resampled for scores of this shape [S, P]."""
    several = zip(("seeds", "partners"), shape, strict=True)
    return " and ".join(name for name, count in several if count > 1) or NOTHING


def interval(
    replicates: np.ndarray, to: str, confidence: float = 0.95
) -> tuple[float, float] | None:
    """Percentile interval of replicates [B].

    None if nothing was resampled or over 5% of them are undefined.
    """
    defined = replicates[np.isfinite(replicates)]
    if to == NOTHING or defined.size < 0.95 * replicates.size:
        return None
    low, high = np.quantile(defined, ((1 - confidence) / 2, (1 + confidence) / 2))
    return float(low), float(high)


def replicate(values: np.ndarray, counts: Iterable[np.ndarray], to: str) -> Draws:
    """Evaluate mean and IQM of values [n] on every row of the chunks of counts.

    `to` is what they generalise to.
    """
    values = entries(values)
    parts = [(weighted_mean(values, chunk), weighted_iqm(values, chunk)) for chunk in counts]
    means, iqms = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Draws(mean(values), iqm(values), means, iqms, values.size, to)


def replicate_crossed(
    scores: np.ndarray,
    row_counts: np.ndarray,
    column_counts: np.ndarray,
    to: str,
    mask: np.ndarray | None = None,
) -> Draws:
    """Replicate a matrix [R, C], or its cells under `mask`, with rows and columns resampled."""
    mask = np.ones(scores.shape, bool) if mask is None else mask
    rows, columns = np.nonzero(mask)
    order = np.argsort(scores[rows, columns], kind="stable")  # sorted once here, not in every chunk
    rows, columns = rows[order], columns[order]
    values = scores[rows, columns]

    def iqms_of(chunk: slice) -> np.ndarray:
        counts = np.take(row_counts[chunk].astype(float), rows, axis=1)
        counts *= np.take(column_counts[chunk].astype(float), columns, axis=1)
        return weighted_iqm(values, counts)

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy lets other threads run meanwhile
        iqms = np.concatenate(list(pool.map(iqms_of, _chunks(len(row_counts), rows.size))))
    # A mean is bilinear in the counts: no cell is visited in any draw.
    sums, totals = (
        ((row_counts @ part) * column_counts).sum(axis=1)
        for part in (np.where(mask, scores, 0.0), 1.0 * mask)
    )
    means = np.divide(sums, totals, out=np.full(len(totals), np.nan), where=totals > 0)
    return Draws(mean(values), iqm(values), means, iqms, values.size, to)


def draw_counts(units: int, resamples: int, rng: np.random.Generator) -> np.ndarray:
    """Counts [B, units] of resamples of `units` things with replacement."""
    return rng.multinomial(units, np.full(units, 1.0 / units), size=resamples)


def cluster_counts(
    shape: tuple[int, int], resamples: int, seed: int
) -> tuple[np.ndarray, np.ndarray]:
    """Counts of whole seeds [B, S] and of partners [B, P].

    A single seed or partner is always drawn once.
    """
    rng = np.random.default_rng(seed)
    return draw_counts(shape[0], resamples, rng), draw_counts(shape[1], resamples, rng)


def _chunks(resamples: int, size: int) -> Iterator[slice]:
    step = max(_ENTRIES_AT_ONCE // size, 1)
    return (slice(start, min(start + step, resamples)) for start in range(0, resamples, step))
