"""Strategies of partners: behaviour of the best robot with each partner, and its clusters.

A partner's features are means over the episodes of the robot with the highest mean return with it,
each scaled to [0, 1] over the partners (theta and phi of BR-Div, ZSC-Eval, arXiv 2310.05208).
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import polars as pl

from evaluation.figures.clustering import Clustering, cluster_profiles
from evaluation.record import tables
from evaluation.record.columns import BEHAVIOUR

FEATURES: Mapping[str, str] = {
    "success": "of episodes",
    "first_contact": "steps",
    "force_mean": "N",
    "force_peak": "N",
    "distance_mean": "m",
    "robot_travel": "rad",
    "human_travel": "rad",
}
MOST_PICKED = 8  # partners of the diverse subset
_TOLERANCE = 1e-9  # of the largest eigenvalue; below it a direction counts as absent


@dataclasses.dataclass(frozen=True)
class Responses:
    """The best robot with each partner of a cross-play, and the behaviour of the pair."""

    partners: list[str]  # P ids
    robots: list[str]  # id of each partner's best robot
    returns: np.ndarray  # [P, P]: with partner a (column) the best robot of partner b (row)
    features: np.ndarray  # [P, F] of each partner with its best robot, in the order of FEATURES


@dataclasses.dataclass(frozen=True)
class Diversity:
    """Diversity of P partners; the determinant itself is 0 once P exceeds the rank."""

    log_determinant: float | None  # of the kernel phi phi^T; None when it is singular
    rank: int
    # (sum l)^2 / sum l^2 of the kernel's eigenvalues l: effective number of directions.
    participation_ratio: float
    n: int  # partners


def best_responses(pairs: pl.DataFrame) -> Responses:
    """Return the best robot with each partner in a table of pairs, and the pairs' features.

    Raises:
        ValueError: The table was written before behaviour was recorded.
    """
    if missing := [name for name in BEHAVIOUR if name not in pairs.columns]:
        raise ValueError(
            f"the table of pairs lacks {', '.join(missing)}: it is from a version that did not "
            "record behaviour; run the cross-play again, into another folder"
        )
    partners = pairs["partner"].unique(maintain_order=True).to_list()
    best = pairs.sort("return", descending=True, maintain_order=True).unique(
        "partner", keep="first"
    )
    best = pl.DataFrame({"partner": partners}).join(
        best, on="partner", how="left", maintain_order="left"
    )
    wide = pairs.pivot("partner", index="ego", values="return")
    rows = (
        best.select("ego").join(wide, on="ego", how="left", maintain_order="left").select(partners)
    )
    return Responses(
        partners,
        best["ego"].to_list(),
        rows.to_numpy(),
        best.select(list(FEATURES)).to_numpy().astype(float),
    )


def summarise_strategies(pairs: pl.DataFrame) -> dict[str, Any]:
    """Return clusters with medoids, BR-Div, a diverse subset and the most incompatible two."""
    responses = best_responses(pairs)
    scaled = scale_features(responses.features)
    clustering = cluster_profiles(scaled)
    diversity = br_diversity(responses.features)
    picked = (
        greedy_subset(responses.features, min(diversity.rank, MOST_PICKED))
        if diversity.rank
        else []
    )
    return {
        "features": dict(FEATURES),
        "partners": [
            {"partner": name, "robot": robot, "cluster": int(label), **_named(row)}
            for name, robot, label, row in zip(
                responses.partners,
                responses.robots,
                clustering.labels,
                responses.features,
                strict=True,
            )
        ],
        "clusters": _clusters(responses, clustering),
        "silhouette": clustering.silhouette,
        "br_div": tables.to_json(diversity),
        "diverse_subset": [responses.partners[i] for i in picked],
        "incompatible": _incompatible(responses),
    }


def br_diversity(features: np.ndarray) -> Diversity:
    """Return the BR-Div of behaviour features theta [P, F] of best responses, scaled to [0, 1]."""
    phi = scale_features(features)
    values = np.linalg.eigvalsh(phi @ phi.T).clip(min=0.0)
    rank = int(np.count_nonzero(values > _TOLERANCE * values.max())) if values.max() > 0 else 0
    singular = rank < len(phi)
    ratio = float(values.sum() ** 2 / np.square(values).sum()) if rank else 0.0
    return Diversity(None if singular else float(np.log(values).sum()), rank, ratio, len(phi))


def greedy_subset(features: np.ndarray, size: int) -> list[int]:
    """Return the indices of `size` diverse partners of features [P, F], in the order of choice.

    Each choice increases the log-determinant of the kernel the most.

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
    """Return features [P, F] scaled to [0, 1] over the partners; a constant feature becomes 0."""
    low, span = features.min(axis=0), np.ptp(features, axis=0)
    return np.divide(features - low, span, out=np.zeros_like(features), where=span > 0)


def _clusters(responses: Responses, clustering: Clustering) -> list[dict[str, Any]]:
    clusters = []
    for label, medoid in enumerate(clustering.medoids):
        members = [i for i in clustering.order if clustering.labels[i] == label]
        clusters.append(
            {
                "medoid": responses.partners[int(medoid)],
                "members": [responses.partners[i] for i in members],
                "mean": _named(responses.features[members].mean(axis=0)),
            }
        )
    return clusters


def _incompatible(responses: Responses) -> dict[str, Any] | None:
    """Return the two partners whose best robots lose the most if exchanged, and these returns.

    Pairs are compared by the smaller of the two losses. If it is never positive, return None.
    """
    best = np.diag(responses.returns)
    loss = best[None, :] - responses.returns  # [robot's partner b, played partner a]
    mutual = np.minimum(loss, loss.T)
    first, second = np.unravel_index(int(np.argmax(mutual)), mutual.shape)
    if mutual[first, second] <= 0:
        return None
    return {
        "partners": [responses.partners[first], responses.partners[second]],
        "robots": [responses.robots[first], responses.robots[second]],
        "returns": [float(best[first]), float(best[second])],
        "returns_exchanged": [
            float(responses.returns[second, first]),
            float(responses.returns[first, second]),
        ],
    }


def _named(row: np.ndarray) -> dict[str, float]:
    return {name: float(value) for name, value in zip(FEATURES, row, strict=True)}
