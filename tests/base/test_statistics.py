import itertools

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from assistax_base import statistics
from tools.release_page.paper.measures import probability_of_improvement

FINITE = st.floats(-1e4, 1e4, width=32)


def test_iqm_by_hand():
    assert statistics.iqm(np.array([1.0, 2, 3, 4])) == 2.5
    assert statistics.iqm(np.array([0.0, 1, 2, 3, 4, 5, 6, 100])) == 3.5
    assert statistics.iqm(np.array([5.0, 1.0, 9.0])) == 5.0  # fewer than four: nothing is cut
    assert statistics.iqm(np.array([0.0, 1, 2, 3, 1000])) == 2.0  # floor(5 / 4) = 1 at either end
    assert statistics.iqm(np.array([[0.0, 10], [20, 30]])) == 15.0  # over all entries


@pytest.mark.slow
@seed(0)
@settings(max_examples=100, deadline=None)
@given(arrays(np.float64, st.integers(1, 40), elements=FINITE))
def test_iqm_is_scipys_trimmed_mean(values: np.ndarray):
    expected = scipy.stats.trim_mean(values, 0.25)
    assert statistics.iqm(values) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_weighted_forms_equal_the_resampled_lists():
    rng = np.random.default_rng(3)
    values = rng.normal(1000, 50, 17)
    counts = rng.integers(0, 4, (20, 17))
    lists = [np.repeat(values, row) for row in counts]
    means = [entry.mean() for entry in lists]
    np.testing.assert_allclose(statistics.weighted_mean(values, counts), means)
    expected = [scipy.stats.trim_mean(entry, 0.25) for entry in lists]
    np.testing.assert_allclose(statistics.weighted_iqm(values, counts), expected)
    counts = np.array([[0, 0], [1, 0]])  # the first resample has no entries
    for figure in (statistics.weighted_mean, statistics.weighted_iqm):
        np.testing.assert_array_equal(figure(np.array([3.0, 4.0]), counts), [np.nan, 3.0])


def test_the_tail_is_weighted_by_hand():
    values = np.arange(1.0, 11.0)[None, ::-1]

    def tail(alpha: float) -> float:
        return float(np.sum(statistics.tail_weights(values, np.ones_like(values), alpha) * values))

    assert tail(0.1) == 1.0
    assert tail(0.25) == pytest.approx((1 + 2 + 0.5 * 3) / 2.5)  # half of the third
    assert tail(0.05) == 1.0
    assert tail(1.0) == pytest.approx(values.mean())
    with pytest.raises(ValueError, match=r"alpha is 0\.0; allowed is a share"):
        tail(0.0)
    weights = statistics.tail_weights(np.array([[3.0, 1.0, 2.0]]), np.array([[1, 2, 1]]), 0.75)
    np.testing.assert_allclose(weights, [[0, 2 / 3, 1 / 3]])


def test_probability_of_improvement_is_the_loop_over_pairs():
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, 4, (3, 5)), rng.integers(0, 4, (4, 5))
    wins = []
    for p in range(5):
        pairs = itertools.product(x[:, p], y[:, p])
        wins.append(np.mean([1.0 if a > b else 0.5 if a == b else 0.0 for a, b in pairs]))
    assert probability_of_improvement(x, y) == pytest.approx(np.mean(wins))
    with pytest.raises(ValueError, match="x has 5 partners and y has 4"):
        probability_of_improvement(x, y[:, :4])


def test_performance_profile_by_hand():
    scores, taus = np.array([[1.0, 2], [3, 4]]), np.array([0.0, 1.0, 2.5, 4.0])
    shares = statistics.performance_profile(scores, taus)
    np.testing.assert_allclose(shares, [1.0, 0.75, 0.5, 0.0])


def test_wrong_scores_are_refused():
    with pytest.raises(ValueError, match="1 of 2 scores are not finite"):
        statistics.iqm(np.array([1.0, np.nan]))
    with pytest.raises(ValueError, match="there are no scores"):
        statistics.mean(np.array([]))
