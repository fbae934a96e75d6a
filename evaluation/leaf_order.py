"""Optimal leaf order of a dendrogram (Bar-Joseph et al., Bioinformatics 17, 2001).

Of the 2^(n-1) orders that a tree allows, the one with the least sum of distances between
neighbours. SciPy's function of this purpose misses it on many trees (scipy/scipy#11227).
"""

import numpy as np


def optimal_leaf_order(linkage: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Return the linkage [n - 1, 4] with each row's two children in their optimal order.

    `best[v][i, j]` is the least length of node v's leaves in a row from its i-th to its j-th, which
    must lie in different children: best over m, k of `left[i, m] + distance[m, k] + right[k, j]`.

    Args:
        linkage: a tree as SciPy has it; node n + i is made by row i.
        distances: distances between leaves [n, n].
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
    ends = [
        (len(linkage) - 1 + n, int(row), int(column))
    ]  # nodes whose first and last leaf are decided
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


def _min_plus(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Matrix product with min for sum and + for times."""
    return np.stack([(row[:, None] + y).min(axis=0) for row in x])
