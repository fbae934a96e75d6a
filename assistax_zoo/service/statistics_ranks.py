"""Which methods are certainly better than which, and the range of ranks that leaves to each.

Two intervals that overlap say little of whose mean is higher, and a place in a sorted list says
less. Here every claim "j is better than k" is tested, all of them at once, on paired resamples:
with 95% confidence no claim on the whole board is wrong. The ranks follow from the claims
(Mogstad, Romano, Shaikh and Wilhelm, "Inference for Ranks", Review of Economic Studies 2024).

Methods are compared by M_test, the mean over partners. An IQM would forgive a robot that fails
with a quarter of them.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from evaluation.bootstrap import RESAMPLES, draw_counts
from evaluation.statistics import score_matrix

CONFIDENCE = 0.95
_ENTRIES_AT_ONCE = 4_000_000  # bounds the memory of a chunk of resamples


@dataclasses.dataclass(frozen=True)
class Ranks:
    """Simultaneous confidence sets for the ranks of M methods."""

    better: np.ndarray  # [M, M] whether method j is certainly better than method k

    @property
    def places(self) -> np.ndarray:
        """Best rank of each method [M]: methods that nothing tells apart share a place."""
        return 1 + self.better.sum(axis=0)

    @property
    def lowest(self) -> np.ndarray:
        """Worst rank of each method [M]."""
        return len(self.better) - self.better.sum(axis=1)


def rank_methods(
    scores: Sequence[np.ndarray],
    *,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Ranks:
    """Rank methods by their mean over partners.

    Args:
        scores: for each method its mean returns [S, P]: its seeds, and the same P partners in the
            same order and on the same episodes as every other method's.
        confidence: that no claim of the result is wrong.
        resamples: number of bootstrap draws; `seed` makes them reproducible.
        seed: seed of the draws.

    Raises:
        ValueError: fewer than two partners, or methods with different numbers of them.
    """
    matrices = _check(scores)
    counts = _resampled(matrices, resamples, seed)
    observed = _moments(matrices, *_observed_counts(matrices))
    t = _over_error(observed.difference[0], observed.error[0])
    replicates = np.concatenate(
        [
            _over_error(drawn.difference - observed.difference, drawn.error).astype(np.float32)
            for drawn in (_moments(matrices, *chunk) for chunk in counts)
        ]
    )
    return Ranks(_close(_step_down(t, replicates, confidence)))


@dataclasses.dataclass(frozen=True)
class _Moments:
    difference: np.ndarray  # [B, M, M] mean of method j less that of k
    error: np.ndarray  # [B, M, M] its standard error


def _moments(
    matrices: Sequence[np.ndarray], seed_counts: Sequence[np.ndarray], partner_counts: np.ndarray
) -> _Moments:
    """Differences of all pairs of methods and their standard errors, in each of B resamples.

    The error has a part for each source of chance: the partners, whose paired differences vary,
    and the seeds of either method.
    """
    partners = partner_counts.shape[1]
    shares = partner_counts / partners  # [B, P]
    columns = np.stack(
        [
            counts @ matrix / len(matrix)
            for matrix, counts in zip(matrices, seed_counts, strict=True)
        ],
        axis=1,
    )  # [B, M, P]
    means = (columns @ shares[:, :, None])[..., 0]  # [B, M]
    centred = columns - means[..., None]
    products = (centred * shares[:, None]) @ centred.transpose(0, 2, 1)
    own = np.diagonal(products, axis1=1, axis2=2)
    of_partners = (own[:, :, None] + own[:, None] - 2 * products) / (partners - 1)
    of_seeds = np.stack(
        [
            _seed_variance(shares @ matrix.T, counts)
            for matrix, counts in zip(matrices, seed_counts, strict=True)
        ],
        axis=1,
    )
    variance = of_partners + of_seeds[:, :, None] + of_seeds[:, None]
    return _Moments(means[:, :, None] - means[:, None], np.sqrt(np.maximum(variance, 0.0)))


def _seed_variance(means: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Variance [B] of the mean over seeds whose means [B, S] were drawn `counts` [B, S] times."""
    seeds = means.shape[1]
    if seeds == 1:  # the method is this one robot, and no other seed is spoken of
        return np.zeros(len(means))
    weights = counts / seeds
    centre = (weights * means).sum(axis=1, keepdims=True)
    return (weights * np.square(means - centre)).sum(axis=1) / (seeds - 1)


def _over_error(difference: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Studentise; a difference without any variation counts as many errors, and none as none."""
    floor = 1e-9 * max(float(np.abs(difference).max()), 1e-300)
    return difference / np.maximum(error, floor)


def _step_down(t: np.ndarray, replicates: np.ndarray, confidence: float) -> np.ndarray:
    """Test all claims at once, then those that are left against what is left (Romano and Wolf).

    A claim stands if it beats the largest statistic that chance gives any claim still open. With
    those found out of the way the bar for the rest is lower, and the confidence in all is kept.
    """
    better = np.zeros(t.shape, bool)
    is_open = ~np.eye(len(t), dtype=bool)
    while is_open.any():
        largest = replicates[:, is_open].max(axis=1)
        found = is_open & (t > np.quantile(largest, confidence, method="higher"))
        if not found.any():
            break
        better |= found
        is_open &= ~found
    return better


def _close(better: np.ndarray) -> np.ndarray:
    """Add what follows: if a is better than b and b than c, then a is better than c."""
    while True:
        closed = better | (better.astype(int) @ better.astype(int) > 0)
        if (closed == better).all():
            return better
        better = closed


def _resampled(
    matrices: Sequence[np.ndarray], resamples: int, seed: int
) -> Iterator[tuple[list[np.ndarray], np.ndarray]]:
    """Yield chunks of counts: of each method's seeds, and of the partners common to all."""
    rng = np.random.default_rng(seed)
    partners = matrices[0].shape[1]
    step = max(_ENTRIES_AT_ONCE // (len(matrices) * partners), 1)
    for start in range(0, resamples, step):
        size = min(step, resamples - start)
        seeds = [draw_counts(len(matrix), size, rng) for matrix in matrices]
        yield seeds, draw_counts(partners, size, rng)


def _observed_counts(matrices: Sequence[np.ndarray]) -> tuple[list[np.ndarray], np.ndarray]:
    """Counts of the sample itself: everything once."""
    return [np.ones((1, len(matrix))) for matrix in matrices], np.ones((1, matrices[0].shape[1]))


def _check(scores: Sequence[np.ndarray]) -> list[np.ndarray]:
    matrices = [score_matrix(one) for one in scores]
    partners = {matrix.shape[1] for matrix in matrices}
    if len(partners) != 1 or min(partners) < 2:
        raise ValueError(
            f"the methods have {', '.join(map(str, sorted(partners))) or 'no'} partners; a ranking "
            "needs the same 2 or more for every method"
        )
    return matrices
