"""BR-Div: diversity by the behaviour of best responses (ZSC-Eval, arXiv 2310.05208)."""

import dataclasses
import math

import numpy as np

_TOLERANCE = 1e-9  # of the largest eigenvalue; below it a direction counts as absent


@dataclasses.dataclass(frozen=True)
class Diversity:
    """Diversity of P partners; the determinant itself is 0 once P exceeds the rank."""

    log_determinant: float | None  # of the kernel phi phi^T; None when it is singular
    rank: int
    # (sum l)^2 / sum l^2 of the kernel's eigenvalues l: effective number of directions.
    participation_ratio: float
    n: int  # partners


def br_diversity(features: np.ndarray) -> Diversity:
    """Diversity of behaviour features theta [P, F] of best responses, each scaled to [0, 1]."""
    phi = scale_features(features)
    values = np.linalg.eigvalsh(phi @ phi.T).clip(min=0.0)
    rank = int(np.count_nonzero(values > _TOLERANCE * values.max())) if values.max() > 0 else 0
    singular = rank < len(phi)
    ratio = float(values.sum() ** 2 / np.square(values).sum()) if rank else 0.0
    return Diversity(None if singular else float(np.log(values).sum()), rank, ratio, len(phi))


def greedy_subset(features: np.ndarray, size: int) -> list[int]:
    """Pick `size` diverse partners of features [P, F].

    Each raises the log-determinant of the picked kernel the most.

    Greedy Cholesky updates (Chen et al., arXiv 1709.05135); ties go to the first.
    """
    phi = scale_features(features)
    rank = br_diversity(features).rank
    if not 1 <= size <= rank:
        raise ValueError(
            f"size is {size}; the features have rank {rank}, so allowed is 1 to {rank}"
        )
    gains = np.square(phi).sum(axis=1)
    factors = np.zeros((len(phi), 0))
    picked: list[int] = []
    while len(picked) < size:
        best = int(np.argmax(gains))
        column = (phi @ phi[best] - factors @ factors[best]) / math.sqrt(gains[best])
        factors = np.column_stack([factors, column])
        gains = gains - np.square(column)
        picked.append(best)
        gains[picked] = -np.inf
    return picked


def scale_features(features: np.ndarray) -> np.ndarray:
    """Scale each feature of [P, F] to [0, 1] over the partners; a constant feature becomes 0."""
    features = np.asarray(features, float)
    if features.ndim != 2 or not features.size:
        raise ValueError(
            f"features has shape {features.shape}; expected [partners, features], neither of them "
            "empty"
        )
    if not np.isfinite(features).all():
        raise ValueError(
            f"{np.count_nonzero(~np.isfinite(features))} features are not finite; mend or exclude "
            "them"
        )
    low, span = features.min(axis=0), np.ptp(features, axis=0)
    return np.divide(features - low, span, out=np.zeros_like(features), where=span > 0)
