"""Variance components and tests of means, against truths that were drawn."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from evaluation.figures.metrics.inference import holm, mean_test
from evaluation.figures.metrics.variance import Spread, spread_of, variance_components


def drawn(rng: np.random.Generator, true: Spread, shape: tuple[int, int, int]) -> np.ndarray:
    s, p, k = shape
    return (
        rng.normal(100.0, true.seeds, (s, 1, 1))
        + rng.normal(0.0, true.partners, (1, p, 1))
        + rng.normal(0.0, true.pairs, (s, p, 1))
        + rng.normal(0.0, true.starts, (1, p, k))
        + rng.normal(0.0, true.episodes, (s, p, k))
    )


def test_components_by_hand():
    """Two robots and two partners: row effects -1 and 1, column effects -2 and 2, pairs 0.5."""
    scores = np.array([[-1.0 - 2 + 0.5, -1.0 + 2 - 0.5], [1.0 - 2 - 0.5, 1.0 + 2 + 0.5]])
    spread = spread_of(scores, 1, 0.0, 0.0)
    assert spread.pairs == pytest.approx(1.0)  # 4 x 0.25 of one degree of freedom
    assert spread.seeds**2 == pytest.approx(2 - 1 / 2)  # variance of the rows less residual / P
    assert spread.partners**2 == pytest.approx(8 - 1 / 2)
    assert spread.interaction_index == pytest.approx(1 / (1 + 1.5 + 7.5))


@pytest.mark.parametrize(
    "true",
    [
        Spread(30.0, 50.0, 40.0, 80.0, 20.0),
        Spread(0.0, 50.0, 0.0, 80.0, 0.0),
        Spread(5.0, 5.0, 60.0, 20.0, 10.0),
    ],
)
@pytest.mark.parametrize("own", [False, True])
def test_components_are_those_that_were_drawn(true: Spread, own: bool):
    """Squares are averaged; with `own` each robot's own partner is left out and earns more."""
    rng, shape = np.random.default_rng(11), (12, 12, 3)
    apart = ~np.eye(12, dtype=bool) if own else None
    found = []
    for _ in range(200):
        returns = drawn(rng, true, shape)
        if own:
            returns[np.arange(12), np.arange(12)] += 1000.0
        variance = variance_components(returns, apart)
        assert variance is not None
        found.append([value**2 for value in dataclasses.astuple(variance.spread)])
    expected = [value**2 for value in dataclasses.astuple(true)]
    # A negative variance is 0, so that small ones are found somewhat too large.
    allowed = 0.06 * max(expected) + 1
    assert np.abs(np.mean(found, axis=0) - expected).max() < allowed


def test_planted_defect_own_partners_are_interaction():
    returns = drawn(np.random.default_rng(1), Spread(5.0, 5.0, 0.0, 5.0), (12, 12, 3))
    returns[np.arange(12), np.arange(12)] += 100.0
    counted = variance_components(returns)
    left = variance_components(returns, ~np.eye(12, dtype=bool))
    assert counted is not None and counted.interaction_index is not None
    assert left is not None and left.interaction_index is not None
    assert counted.interaction_index > 0.9 and left.interaction_index < 0.1


def test_interaction_test_holds_level_and_power():
    rng = np.random.default_rng(3)

    def shares(pairs: float) -> float:
        tables = (drawn(rng, Spread(20, 20, pairs, 40, 10), (6, 10, 4)) for _ in range(400))
        chances = [variance.interaction_p for t in tables if (variance := variance_components(t))]
        return float(np.mean([chance is not None and chance < 0.05 for chance in chances]))

    assert 0.03 < shares(0.0) < 0.075
    assert shares(30.0) > 0.9


def test_single_robot_or_episode_lacks_components():
    returns = np.arange(12.0).reshape(2, 3, 2)
    assert variance_components(returns[:1]) is None
    assert variance_components(returns, np.eye(2, 3, dtype=bool)) is None
    once = variance_components(returns[..., :1])
    assert once is not None and once.interaction_p is None


def test_a_mean_test_of_one_partner_is_welchs():
    rng = np.random.default_rng(2)
    a, b = rng.normal(3, 1, 9), rng.normal(2, 2, 14)
    welch = stats.ttest_ind(a, b, equal_var=False)
    found = mean_test(a[:, None], b[:, None])
    assert found.p == pytest.approx(welch.pvalue)
    assert found.freedom == pytest.approx(welch.df)


def test_mean_test_of_single_seeds_is_paired():
    rng = np.random.default_rng(4)
    a, b = rng.normal(3, 1, (1, 12)), rng.normal(2, 1, (1, 12))
    assert mean_test(a, b).p == pytest.approx(stats.ttest_rel(a[0], b[0]).pvalue)


def pairs_of_methods(
    rng: np.random.Generator, effect: float, seeds: int, partners: int, sds: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    of_seeds, common, of_partners, of_pairs = sds
    shared = rng.normal(0, common, partners)
    apart = rng.normal(0, of_partners, partners)

    def method(mean: np.ndarray) -> np.ndarray:
        table = rng.normal(0, of_seeds, (seeds, 1)) + rng.normal(0, of_pairs, (seeds, partners))
        return table + shared + mean

    return method(effect + apart), method(np.zeros(partners))


CASES = [
    (4, 40, (30.0, 80.0, 20.0, 20.0)),
    (8, 40, (30.0, 80.0, 60.0, 30.0)),
    (32, 40, (30.0, 80.0, 60.0, 60.0)),
    (32, 8, (10.0, 80.0, 60.0, 10.0)),
]


@pytest.mark.parametrize(("seeds", "partners", "sds"), CASES)
def test_level_and_power(seeds: int, partners: int, sds: tuple[float, ...]):
    """Of no difference 5% are found; of the detectable difference 80%."""
    rng = np.random.default_rng(7)
    null = [mean_test(*pairs_of_methods(rng, 0.0, seeds, partners, sds)) for _ in range(1500)]
    assert 0.033 < np.mean([test.p < 0.05 for test in null]) < 0.066
    effect = float(np.mean([test.detectable(0.05) for test in null]))
    there = [mean_test(*pairs_of_methods(rng, effect, seeds, partners, sds)) for _ in range(600)]
    assert 0.74 < np.mean([test.p < 0.05 for test in there]) < 0.86


def test_level_with_groups_of_partners():
    """Teams are few, and their differences are spread most; seeds differ in a group as a whole."""
    rng, sizes = np.random.default_rng(8), (30, 30, 6)
    groups = np.repeat(["known", "unseen", "teams"], sizes)
    scale = np.repeat([1.0, 1.0, 3.0], sizes)

    def method() -> np.ndarray:
        of_groups = np.repeat(rng.normal(0, 20, (4, 3)), sizes, axis=1)
        return of_groups + rng.normal(0, 30, (4, 66)) + rng.normal(0, 20, 66) * scale

    tables = [(method(), method()) for _ in range(1000)]
    found = [mean_test(*pair, groups.tolist()) for pair in tables]
    means = [a.mean(axis=0) - b.mean(axis=0) for a, b in tables]
    by_hand = [np.mean([mean[groups == name].mean() for name in {*groups}]) for mean in means]
    assert [test.difference for test in found] == pytest.approx(by_hand)
    spread, errors = np.var(by_hand), [test.error**2 for test in found]
    assert np.mean(errors) == pytest.approx(spread, rel=0.1)
    assert 0.033 < np.mean([test.p < 0.05 for test in found]) < 0.066


def test_group_of_a_single_partner_widens_the_test():
    scores, groups = np.random.default_rng(9).normal(5, 1, (2, 3, 5)), ["a", "b", "b", "b", "b"]
    found = mean_test(*scores, groups)
    by_hand = (scores[0] - scores[1]).mean(axis=0)
    assert found.difference == pytest.approx((by_hand[0] + by_hand[1:].mean()) / 2)
    assert found == mean_test(*(scores * [2.5, 0.625, 0.625, 0.625, 0.625]))


def test_without_any_variance_equal_means_are_equal():
    same = np.ones((3, 4))
    assert mean_test(same, same).p == 1.0
    assert mean_test(same + 1, same).p == 0.0
    assert mean_test(np.ones((1, 1)), np.zeros((1, 1))).p == 1.0  # nothing says anything


def test_holm_by_hand():
    assert holm((0.01, 0.04, 0.03)) == pytest.approx((0.03, 0.06, 0.06))
    assert holm((0.5, 0.9)) == (1.0, 1.0)
    assert holm(()) == ()


def test_holm_bounds_the_chance_of_any_wrong_finding():
    rng = np.random.default_rng(5)
    wrong = [min(holm(tuple(rng.uniform(size=6)))) <= 0.05 for _ in range(4000)]
    assert np.mean(wrong) < 0.06
    bare = [rng.uniform(size=6).min() <= 0.05 for _ in range(4000)]
    assert np.mean(bare) > 0.2  # the test can fail
