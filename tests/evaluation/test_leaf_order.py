import itertools

import numpy as np
import pytest
from scipy.cluster import hierarchy
from scipy.spatial import distance

from evaluation.figures.clustering import optimal_leaf_order


def length(order: list[int], distances: np.ndarray) -> float:
    return float(sum(distances[a, b] for a, b in itertools.pairwise(order)))


def all_orders(linkage: np.ndarray) -> list[list[int]]:
    """Return every order that the tree allows."""
    n = len(linkage) + 1
    orders = {leaf: [[leaf]] for leaf in range(n)}
    for i, (a, b) in enumerate(linkage[:, :2].astype(int)):
        pairs = list(itertools.product(orders[a], orders[b]))
        orders[n + i] = [x + y for x, y in pairs] + [y + x for x, y in pairs]
    return orders[2 * n - 2]


@pytest.mark.parametrize("seed", range(20))
def test_no_order_that_the_tree_allows_is_shorter(seed: int):
    rng = np.random.default_rng(seed)
    condensed = distance.pdist(rng.normal(size=(int(rng.integers(2, 10)), 3)))
    distances = distance.squareform(condensed)
    tree = hierarchy.average(condensed)
    ordered = optimal_leaf_order(tree, distances)
    leaves = hierarchy.leaves_list(ordered).tolist()
    assert length(leaves, distances) == pytest.approx(
        min(length(order, distances) for order in all_orders(tree))
    )
    assert leaves in all_orders(tree)
    assert leaves == hierarchy.dendrogram(ordered, no_plot=True)["leaves"]
    np.testing.assert_array_equal(ordered[:, 2:], tree[:, 2:])


def test_a_chain_of_many_leaves_needs_no_recursion():
    points = np.cumsum(np.arange(1.0, 301.0))[:, None]
    condensed = distance.pdist(points)
    ordered = optimal_leaf_order(hierarchy.single(condensed), distance.squareform(condensed))
    order = hierarchy.leaves_list(ordered).tolist()
    assert order in (list(range(300)), list(range(300))[::-1])
