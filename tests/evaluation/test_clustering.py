import itertools
from pathlib import Path

import numpy as np
import pytest
from scipy.cluster import hierarchy
from scipy.spatial import distance

from evaluation.figures import clustering
from evaluation.figures.clustering import convention_groups
from evaluation.figures.saved_tables import pair_table
from evaluation.record.record import Record
from tests.evaluation.episode_tables import clustered_matrix, episode_table, team_id, teams
from tools.release_page.paper.measures import branches


def test_known_clusters_are_found_and_stand_together():
    clusters = clustering.cluster_teams(clustered_matrix(18, 3))
    truth = np.arange(18) % 3
    assert clusters.silhouette is not None and clusters.silhouette > 0.8
    assert len(clusters.medoids) == 3
    for label, medoid in enumerate(clusters.medoids):
        members = np.flatnonzero(clusters.labels == label)
        assert len(set(truth[members])) == 1
        assert medoid in members
    assert [label for label, _ in itertools.groupby(clusters.labels[clusters.order])] == [0, 1, 2]


@pytest.mark.parametrize(
    ("count", "outliers", "sizes"),
    [(6, [100.0], [1, 6, 6]), (6, [100.0, 100.1], [2, 12]), (29, [100.0, 100.1], [2, 29, 29])],
    ids=["one outlier", "two are a cluster of 14", "two are outliers of 60"],
)
def test_few_far_points_are_outliers(count: int, outliers: list[float], sizes: list[int]):
    points = [*np.linspace(0, 1, count), *np.linspace(5, 6, count), *outliers]
    labels = clustering.cluster_profiles(np.array(points)[:, None]).labels
    assert sorted(np.bincount(labels)) == sizes


def test_branches_are_the_leaves_below_each_node():
    tree = hierarchy.average(np.array([[0.0], [1.0], [10.0], [12.0]]))
    assert [sorted(branch) for branch in branches(tree)] == [[0, 1], [2, 3], [0, 1, 2, 3]]


def test_without_structure_all_are_one_cluster():
    clusters = clustering.cluster_profiles(np.random.default_rng(0).normal(size=(40, 40)))
    assert len(clusters.medoids) == 1 and clusters.silhouette is not None
    assert clusters.silhouette < clustering.MIN_SILHOUETTE


def test_order_begins_with_higher_returns():
    points = np.array([[0.0], [1.0], [1.2], [50.0], [51.0], [51.1]])
    clusters = clustering.cluster_profiles(points)
    assert clusters.labels.tolist() == [1, 1, 1, 0, 0, 0]
    assert clusters.medoids.tolist() == [4, 1]  # nearest to all others of their cluster
    assert set(clusters.order[:3]) == {3, 4, 5}
    assert clusters.order.tolist() == hierarchy.leaves_list(clusters.linkage).tolist()


def test_silhouette_equals_definition():
    points = np.random.default_rng(0).normal(size=(9, 2))
    labels = np.array([0, 0, 0, 0, 1, 1, 1, 1, 2])
    distances = distance.squareform(distance.pdist(points))
    scores = []
    for i, label in enumerate(labels):
        own = [j for j in range(9) if labels[j] == label and j != i]
        if not own:
            scores.append(0.0)
            continue
        a = distances[i, own].mean()
        b = min(distances[i, labels == other].mean() for other in set(labels) - {label})
        scores.append((b - a) / max(a, b))
    assert clustering.silhouette(labels, distances) == pytest.approx(np.mean(scores))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_small_and_equal_profiles_have_an_order(count: int):
    clusters = clustering.cluster_profiles(np.ones((count, 4)))
    assert sorted(clusters.order) == list(range(count))
    assert len(clusters.medoids) == 1


def test_wrong_matrices_are_refused():
    with pytest.raises(ValueError, match=r"shape \(2, 3\); teams in one order need the same teams"):
        clustering.cluster_teams(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="expected finite returns"):
        clustering.cluster_profiles(np.array([[1.0, np.nan]]))


def test_json_names_policies_in_order():
    profiles = np.array([[0.0], [10.0], [0.5], [10.5]])
    clusters = clustering.cluster_profiles(profiles).to_json(["a", "b", "c", "d"])
    assert set(clusters["order"][:2]) == {"b", "d"}
    assert [set(cluster["members"]) for cluster in clusters["clusters"]] == [{"b", "d"}, {"a", "c"}]
    assert clusters["leaves"] == ["a", "b", "c", "d"]


def test_convention_groups_share_suitable_robots() -> None:
    """Six teams of two groups: robots earn 900 within their group and 600 across."""
    matrix = clustered_matrix(6, 2)
    matrix[::2, ::2] += 100.0  # teams of this group do better with one another
    table = episode_table(matrix[:, :, None], teams(6), teams(6))
    pairs = pair_table(Record(table, Path("nowhere")))
    groups = convention_groups(pairs)
    names = [team_id(team) for team in teams(6)]
    assert [groups[name] for name in names] == ["a", "b"] * 3
    with pytest.raises(ValueError, match="convention groups need every robot"):
        convention_groups(pairs[1:])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.ones((3, 3)), "form no two groups"),
        (np.outer([1.0, 2.0, 3.0], np.ones(3)), "form no two groups"),
        (np.outer([1.0, 2.0, 3.0, 4.0], [1.0, 2.0, 5.0, 9.0]), "form no two groups"),
        (np.full((4, 4), np.nan), "returns that are not finite"),
        (np.diag([np.inf, 1.0, 2.0]), "returns that are not finite"),
    ],
    ids=["one return", "a column for all", "one order", "nan", "infinity"],
)
def test_humans_without_groups_are_refused(matrix: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        clustering.conventions(matrix)


def test_a_usual_human_joins_the_nearer_group() -> None:
    """The last human ranks all robots as everybody does on average: it has no correlation."""
    matrix = np.array([[9.0, 9, 1, 1, 5], [8, 8, 2, 2, 4], [2, 2, 8, 8, 4], [1, 1, 9, 9, 5]])
    matrix = np.vstack([matrix, [5.0, 5, 5, 5, 5]])
    groups = clustering.conventions(matrix)
    assert groups[0] == groups[1] != groups[2] == groups[3]


def test_the_same_robot_twice_changes_nothing() -> None:
    matrix = clustered_matrix(6, 2)
    twice = matrix[np.ix_([*range(6), 5], [*range(6), 5])]
    assert clustering.conventions(twice)[:6].tolist() == clustering.conventions(matrix).tolist()
    clusters = clustering.cluster_teams(twice)
    assert clusters.labels[5] == clusters.labels[6]
