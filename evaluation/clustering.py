"""Order and clusters of a cross-play matrix: average linkage, optimal leaf order."""

import dataclasses
import math

import numpy as np
from scipy.cluster import hierarchy
from scipy.spatial import distance

from evaluation.leaf_order import optimal_leaf_order

MAX_CLUSTERS = 8
# Below it Kaufman and Rousseeuw (1990) see no substantial structure: then all are one cluster.
MIN_SILHOUETTE = 0.25
LEAST_SHARE = 0.05  # of all, of a cluster that counts; smaller ones are outliers


@dataclasses.dataclass(frozen=True)
class Clustering:
    """Hierarchical clustering of n policies or teams by their returns."""

    order: np.ndarray  # [n] indices from first to last leaf
    labels: np.ndarray  # [n] cluster of each, numbered from 0 along `order`
    medoids: np.ndarray  # [clusters] index of each cluster's member nearest to all its others
    silhouette: (
        float | None
    )  # of the best cut, even if it was too low to be taken; None if none is possible
    linkage: np.ndarray  # [n - 1, 4] as SciPy has it, leaves ordered

    def to_json(self, names: list[str]) -> dict:
        """Return JSON-ready values that name the policies, in the clustered order."""
        return {
            "order": [names[i] for i in self.order],
            "clusters": [
                {
                    "medoid": names[medoid],
                    "members": [names[i] for i in self.order if self.labels[i] == label],
                }
                for label, medoid in enumerate(self.medoids)
            ],
            "silhouette": self.silhouette,
            "linkage": self.linkage.tolist(),
            "leaves": names,
        }


def cluster_profiles(profiles: np.ndarray) -> Clustering:
    """Cluster rows of profiles [n, m] by Euclidean distance.

    Of the cuts with 2 to 8 clusters, at least two of them with several members and 5% of all, that
    of the highest mean silhouette is taken if it reaches 0.25; else all are one. A cut that only
    sets outliers apart would say nothing of the others.
    """
    profiles = np.asarray(profiles, float)
    if profiles.ndim != 2 or not profiles.size or not np.isfinite(profiles).all():
        raise ValueError(
            f"profiles has shape {profiles.shape}; expected finite returns [policies, others], "
            "none empty"
        )
    if len(profiles) == 1:
        zero = np.zeros(1, int)
        return Clustering(zero, zero, zero, None, np.zeros((0, 4)))
    condensed = distance.pdist(profiles)
    distances = distance.squareform(condensed)
    linkage = optimal_leaf_order(hierarchy.average(condensed), distances)
    order = hierarchy.leaves_list(linkage)
    first, last = np.array_split(profiles.mean(axis=1)[order], 2)
    if (
        first.mean() < last.mean()
    ):  # an order and its reverse are equally good: begin with the higher returns
        linkage[:, :2] = linkage[:, 1::-1]
        order = order[::-1]
    labels, score = _best_cut(linkage, distances)
    labels = _numbered_along(labels, order)
    return Clustering(order, labels, _medoids(labels, distances), score, linkage)


def cluster_teams(matrix: np.ndarray) -> Clustering:
    """Cluster teams by a square matrix [T, T].

    How a team's robot fares with all humans and its human with all robots.

    Rows and columns then share one order, and self-play stays on the diagonal.
    """
    matrix = np.asarray(matrix, float)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(
            f"the matrix has shape {matrix.shape}; teams in one order need the same teams on both "
            "axes"
        )
    return cluster_profiles(np.concatenate([matrix, matrix.T], axis=1))


def least_members(count: int) -> int:
    """Return how many of `count` policies make a cluster that is more than outliers."""
    return max(2, math.ceil(LEAST_SHARE * count))


def silhouette(labels: np.ndarray, distances: np.ndarray) -> float:
    """Mean silhouette (b - a) / max(a, b) of labels [n] under distances [n, n].

    A member alone scores 0.
    """
    members = labels[None, :] == np.unique(labels)[:, None]
    sizes = members.sum(axis=1)
    sums = distances @ members.T
    own = np.argmax(members, axis=0)
    rows = np.arange(len(labels))
    inside = sums[rows, own] / np.maximum(sizes[own] - 1, 1)
    others = sums / sizes
    others[rows, own] = np.inf
    outside = others.min(axis=1)
    widest = np.maximum(inside, outside)
    scores = np.divide(
        outside - inside, widest, out=np.zeros(len(labels)), where=(widest > 0) & (sizes[own] > 1)
    )
    return float(scores.mean())


def _best_cut(linkage: np.ndarray, distances: np.ndarray) -> tuple[np.ndarray, float | None]:
    n = len(distances)
    cuts = [
        hierarchy.fcluster(linkage, k, "maxclust") for k in range(2, min(MAX_CLUSTERS, n - 1) + 1)
    ]
    cuts = [
        labels for labels in cuts if np.count_nonzero(np.bincount(labels) >= least_members(n)) > 1
    ]
    if not cuts:
        return np.zeros(n, int), None
    scores = [silhouette(labels, distances) for labels in cuts]
    score, labels = (
        max(scores),
        cuts[int(np.argmax(scores))],
    )  # of equal ones that with the fewest clusters
    return (labels if score >= MIN_SILHOUETTE else np.zeros(n, int)), score


def _numbered_along(labels: np.ndarray, order: np.ndarray) -> np.ndarray:
    numbers: dict[int, int] = {}
    for label in labels[order]:
        numbers.setdefault(int(label), len(numbers))
    return np.array([numbers[int(label)] for label in labels])


def _medoids(labels: np.ndarray, distances: np.ndarray) -> np.ndarray:
    medoids = []
    for label in range(labels.max() + 1):
        members = np.flatnonzero(labels == label)
        medoids.append(members[distances[np.ix_(members, members)].sum(axis=1).argmin()])
    return np.array(medoids)
