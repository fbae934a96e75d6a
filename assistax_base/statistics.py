"""Aggregates of scores [S, P].

Seeds of one method by partners, each score a mean over a pair's episodes.

Definitions follow rliable (Agarwal et al., arXiv 2108.13264). The `weighted_` forms take counts [B,
n], how often each entry stands in each of B resamples, and give one figure for each: exact, and
vectorised over resamples.
"""

import numpy as np
from jaxtyping import Float, Num


def iqm(values: Num[np.ndarray, "..."]) -> float:
    """Interquartile mean: floor(n / 4) entries are cut at either end, as rliable cuts them."""
    ordered = np.sort(entries(values))
    cut = ordered.size // 4
    return float(ordered[cut : ordered.size - cut].mean())


def mean(values: Num[np.ndarray, "..."]) -> float:
    """Mean of all entries."""
    return float(entries(values).mean())


def performance_profile(
    values: Num[np.ndarray, "..."], thresholds: Num[np.ndarray, " T"]
) -> Float[np.ndarray, " T"]:
    """Share of entries above each threshold."""
    ordered = np.sort(entries(values))
    return (
        1.0 - np.searchsorted(ordered, np.asarray(thresholds, float), side="right") / ordered.size
    )


def tail_weights(
    values: Num[np.ndarray, "B n"], counts: Num[np.ndarray, "B n"], alpha: float
) -> Float[np.ndarray, "B n"]:
    """Weights, rows summing to 1, of the lowest share `alpha` of counted entries."""
    if not 0.0 < alpha <= 1.0:
        raise ValueError(f"alpha is {alpha}; allowed is a share in (0, 1]")
    order = np.argsort(values, axis=1, kind="stable")
    reached = np.cumsum(np.take_along_axis(counts, order, axis=1), axis=1, dtype=float)
    mass = alpha * reached[:, -1:]
    weights = np.empty_like(reached)
    np.put_along_axis(
        weights, order, np.diff(np.minimum(reached, mass), axis=1, prepend=0.0) / mass, axis=1
    )
    return weights


def weighted_mean(
    values: Num[np.ndarray, " n"] | Num[np.ndarray, "B n"], counts: Num[np.ndarray, "B n"]
) -> Float[np.ndarray, " B"]:
    """Mean of values under counts; NaN where a row of counts is empty."""
    total = counts.sum(axis=1)
    sums = _row_products(counts, values)
    return np.divide(sums, total, out=np.full(len(total), np.nan), where=total > 0)


def weighted_iqm(
    values: Num[np.ndarray, " n"] | Num[np.ndarray, "B n"], counts: Num[np.ndarray, "B n"]
) -> Float[np.ndarray, " B"]:
    """Interquartile mean of values under whole-number counts.

    NaN where a row of counts is empty. Values may also be [B, n], each row sorted.
    """
    if values.ndim == 1 and np.any(np.diff(values) < 0):
        order = np.argsort(values, kind="stable")
        values, counts = values[order], counts[:, order]
    centre = values.mean()  # subtracting it keeps the sums by parts below small
    reached = np.cumsum(counts, axis=1, dtype=float)
    total = reached[:, -1].copy()
    low = np.floor(total / 4)
    high = total - low
    np.clip(reached, low[:, None], high[:, None], out=reached)
    # Entry i keeps reached[i] - reached[i - 1] of its counts; summed by parts, this needs no second
    # array.
    kept = (
        high * (values[..., -1] - centre)
        - low * (values[..., 0] - centre)
        - _row_products(reached[:, :-1], np.diff(values))
    )
    return np.divide(kept, high - low, out=np.full(len(total), np.nan), where=total > 0) + centre


def _row_products(counts: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return sums [B] of counts [B, n] times values [n], or times each row's own, [B, n]."""
    return counts @ values if values.ndim == 1 else np.einsum("bn,bn->b", counts, values)


def entries(values: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return all entries as a flat float array; refuse an empty one and non-finite entries."""
    flat = np.asarray(values, float).ravel()
    if not flat.size:
        raise ValueError("there are no scores; at least one is needed")
    if not np.isfinite(flat).all():
        count = np.count_nonzero(~np.isfinite(flat))
        raise ValueError(f"{count} of {flat.size} scores are not finite; mend or exclude them")
    return flat


def score_matrix(scores: np.ndarray) -> Float[np.ndarray, "S P"]:
    """Return scores as [S, P].

    [S] counts as seeds with one partner, and an axis of episodes is refused.
    """
    scores = np.asarray(scores, float)
    if scores.ndim not in (1, 2):
        raise ValueError(
            f"scores has shape {scores.shape}; expected [seeds, partners], each score a mean over "
            "episodes, because episodes are not seeds"
        )
    entries(scores)
    return scores[:, None] if scores.ndim == 1 else scores


def returns_of(
    scores: np.ndarray,
) -> Float[np.ndarray, "S P K"] | Float[np.ndarray, "S P"]:
    """Return returns [S, P, K] or scores [S, P] as floats; [S] counts as seeds with one partner."""
    scores = np.asarray(scores, float)
    if scores.ndim != 3:
        return score_matrix(scores)
    entries(scores)
    return scores
