"""Order and clusters of a cross-play matrix: average linkage, optimal leaf order."""

import dataclasses
import math
from typing import Any

import numpy as np
import polars as pl
from scipy.cluster import hierarchy
from scipy.spatial import distance

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
    # Of the best cut, even if it was too low to be taken; None if none is possible.
    silhouette: float | None
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
    """Return the clustering of rows of profiles [n, m] by Euclidean distance.

    The cut has 2 to 8 clusters, at least two of them with several members and 5% of all rows, and
    the highest mean silhouette. If that is below 0.25, all rows are one cluster. A cut that only
    separates outliers is not considered.
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
    # An order and its reverse are equally good: begin with the higher returns.
    if first.mean() < last.mean():
        linkage[:, :2] = linkage[:, 1::-1]
        order = order[::-1]
    labels, score = _best_cut(linkage, distances)
    labels = _numbered_along(labels, order)
    return Clustering(order, labels, _medoids(labels, distances), score, linkage)


def cluster_teams(matrix: np.ndarray) -> Clustering:
    """Return the clustering of teams by a square matrix [T, T] of robots with humans.

    A team's profile is its row and its column. Rows and columns share one order, so self-play stays
    on the diagonal.
    """
    matrix = np.asarray(matrix, float)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(
            f"the matrix has shape {matrix.shape}; teams in one order need the same teams on both "
            "axes"
        )
    return cluster_profiles(np.concatenate([matrix, matrix.T], axis=1))


def clustered_order(pairs: pl.DataFrame) -> dict[str, Any]:
    """Return the clustered order of a cross-play's table of pairs.

    It has `rows` and `columns`, clustered separately, and `teams`: one order for both axes, with
    self-play on the diagonal, or None unless both axes have the same teams.

    Raises:
        ValueError: The table lacks a pair, or a return is not finite.
    """
    wide = pairs.pivot("partner", index="ego", values="return")
    scores = wide.drop("ego").cast(pl.Float64).to_numpy(order="c")
    if not np.isfinite(scores).all():
        raise ValueError(
            "the table of pairs has no return for some pairs, or none that is finite; run the "
            "cross-play again into the same folder"
        )
    rows, columns = (
        pairs.unique(seat, keep="first", maintain_order=True)[f"{seat}_team"].to_list()
        for seat in ("ego", "partner")
    )
    whole = None not in rows and len(set(rows)) == len(rows)
    shared = whole and sorted(rows) == sorted(columns, key=str)
    return {
        "linkage": "average",
        "distance": "euclidean",
        "rows": cluster_profiles(scores).to_json(wide["ego"].to_list()),
        "columns": cluster_profiles(scores.T).to_json(wide.columns[1:]),
        "teams": cluster_teams(scores[:, [columns.index(team) for team in rows]]).to_json(rows)
        if shared
        else None,
    }


def conventions(matrix: np.ndarray) -> np.ndarray:
    """Return the group of each human as a mask [T], True for the group with the higher returns.

    Humans are clustered by average linkage of 1 - correlation of the robots' ranks with them, minus
    each robot's mean rank. Ranks are used because one episode with 20 s of pressure outweighs all
    others of a human. Humans with the mean ranks are alike, and uncorrelated with others. The
    groups are compared by the median return of robots with humans of their own group.

    Args:
        matrix: Mean returns [T, T] of robots with humans, by team.

    Raises:
        ValueError: A return is not finite, or the humans do not form two groups, for example
            because all rank the robots alike.
    """
    from scipy import stats  # half a second, hence not at every start

    if not np.isfinite(matrix).all():
        raise ValueError("the cross-play has returns that are not finite; run it again")
    ranks = stats.rankdata(matrix, axis=0)
    deviations = (ranks - ranks.mean(axis=1, keepdims=True)).T
    distances = distance.pdist(deviations, "correlation")
    # Humans with the mean ranks have no correlation.
    has_mean_ranks = ~deviations.any(axis=1)
    unlike = distance.squareform(has_mean_ranks[:, None] != has_mean_ranks, checks=False)
    distances = np.where(np.isnan(distances), unlike, distances)
    first = hierarchy.fcluster(hierarchy.average(distances), 2, "maxclust") == 1
    if first.all():
        raise ValueError(
            f"the {len(first)} humans form no two groups: they rank the robots alike, or each in a "
            "way of its own; make the split without convention groups, or play other teams"
        )
    within = [np.median(matrix[np.ix_(group, group)]) for group in (first, ~first)]
    return first if within[0] > within[1] else ~first


def convention_groups(pairs: pl.DataFrame) -> dict[str, str]:
    """Return the convention group, "a" or "b", of each team of a cross-play's table of pairs.

    Raises:
        ValueError: A team lacks its robot or its human, or the humans do not form two groups.
    """
    played = pairs.filter(pl.col("ego_team").is_in(pairs["partner_team"].drop_nulls().to_list()))
    wide = played.pivot("partner_team", index="ego_team", values="return").sort("ego_team")
    teams = wide["ego_team"].to_list()
    if (
        len(teams) < 3
        or sorted(wide.columns[1:]) != teams
        or wide.null_count().row(0) != (0,) * (len(teams) + 1)
    ):
        raise ValueError(
            f"the cross-play has {len(teams)} robots whose humans play too, of "
            f"{wide.width - 1} humans; convention groups need every robot of 3 teams or more with "
            "every human of theirs, and no others"
        )
    first = conventions(wide.select(teams).to_numpy())
    return {team: "a" if own else "b" for team, own in zip(teams, first, strict=True)}


def least_members(count: int) -> int:
    """Return the least size of a cluster among `count` policies that are not outliers."""
    return max(2, math.ceil(LEAST_SHARE * count))


def optimal_leaf_order(linkage: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Return the linkage [n - 1, 4] with each row's two children in their optimal order.

    It has the least sum of distances between neighbours among the 2^(n-1) orders of the tree
    (Bar-Joseph et al., Bioinformatics 17, 2001). SciPy's function for it misses the optimum on many
    trees (scipy/scipy#11227).

    `best[v][i, j]` is the least length of node v's leaves in a row from its i-th to its j-th, which
    must lie in different children: best over m, k of `left[i, m] + distance[m, k] + right[k, j]`.

    Args:
        linkage: A tree in SciPy's form; row i makes node n + i.
        distances: Distances between leaves [n, n].
    """
    n = len(distances)
    leaves = [np.array([leaf]) for leaf in range(n)]
    best = [np.zeros((1, 1)) for _ in range(n)]
    children = linkage[:, :2].astype(int)
    for a, b in children:
        between = distances[np.ix_(leaves[a], leaves[b])]
        across = _min_plus(_min_plus(best[a], between), best[b])
        leaves.append(np.concatenate([leaves[a], leaves[b]]))
        apart_a, apart_b = (np.full((len(leaves[x]),) * 2, np.inf) for x in (a, b))
        best.append(np.block([[apart_a, across], [across.T, apart_b]]))
    ordered = linkage.copy()
    row, column = np.unravel_index(best[-1].argmin(), best[-1].shape)
    # Nodes whose first and last leaf are decided.
    ends = [(len(linkage) - 1 + n, int(row), int(column))]
    while ends:
        node, first, last = ends.pop()
        if node < n:
            continue
        a, b = children[node - n]
        size = len(leaves[a])
        if first >= size:  # the row begins in the second child
            a, b, size, first, last = b, a, len(leaves[b]), first - size, last + len(leaves[b])
        ordered[node - n, :2] = a, b
        last -= size
        joint = best[a][first][:, None] + distances[np.ix_(leaves[a], leaves[b])] + best[b][:, last]
        m, k = np.unravel_index(joint.argmin(), joint.shape)
        ends += [(a, first, int(m)), (b, int(k), last)]
    return ordered


def silhouette(labels: np.ndarray, distances: np.ndarray) -> float:
    """Return the mean silhouette (b - a) / max(a, b) of labels [n] under distances [n, n].

    The only member of a cluster has silhouette 0.
    """
    members = labels[None, :] == np.unique(labels)[:, None]
    sizes = members.sum(axis=1)
    sums = distances @ members.T
    clusters = np.argmax(members, axis=0)
    rows = np.arange(len(labels))
    inside = sums[rows, clusters] / np.maximum(sizes[clusters] - 1, 1)
    others = sums / sizes
    others[rows, clusters] = np.inf
    outside = others.min(axis=1)
    widest = np.maximum(inside, outside)
    scores = np.divide(
        outside - inside,
        widest,
        out=np.zeros(len(labels)),
        where=(widest > 0) & (sizes[clusters] > 1),
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
    # Among equal scores, the fewest clusters.
    score, labels = (max(scores), cuts[int(np.argmax(scores))])
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


def _min_plus(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the min-plus product of two matrices: min for sum, + for times."""
    return np.stack([(row[:, None] + y).min(axis=0) for row in x])
