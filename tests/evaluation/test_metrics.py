import itertools

import numpy as np
import pytest
import scipy.stats

from assistax_base.statistics import iqm
from evaluation.figures import metrics, strategies
from evaluation.figures.metrics import Bounds, Traits


def same_traits(
    teams: list[str], algorithms: list[str] | None = None, disabilities: list[str] | None = None
) -> Traits:
    return Traits(teams, algorithms or ["ippo"] * len(teams), disabilities or ["d1"] * len(teams))


def test_zero_shot_separates_sides():
    scores = np.array([[1.0, 2, 3, 100], [5, 6, 7, 100]])
    figures = metrics.zero_shot(scores, ["test", "train", "test", None])
    assert figures.m_test and figures.m_train and figures.gap
    assert (figures.m_test.mean, figures.m_test.n) == (4.0, 4)
    assert (figures.m_train.mean, figures.m_train.n) == (4.0, 2)
    assert figures.gap.mean == 0.0
    only_test = metrics.zero_shot(scores[:, :1], ["test"])
    assert (only_test.m_train, only_test.gap) == (None, None)
    with pytest.raises(ValueError, match="no partner is on a side"):
        metrics.zero_shot(scores[:, 3:], [None])


def test_the_generalisation_gap_is_paired_by_seed():
    """Seeds differ by hundreds, the gap of each is 5."""
    seeds = np.array([[0.0], [300.0], [600.0], [900.0]])
    scores = np.concatenate([seeds + np.zeros((4, 6)), seeds + np.full((4, 6), 5.0)], axis=1)
    figures = metrics.zero_shot(scores, ["test"] * 6 + ["train"] * 6)
    assert figures.gap is not None and figures.gap.mean_ci == pytest.approx((5.0, 5.0))
    assert figures.m_test is not None and figures.m_test.mean_ci is not None
    assert np.ptp(figures.m_test.mean_ci) > 400


def test_fairness_is_spread_of_group_means():
    scores = np.array([[10.0, 20, 30, 40, 7]])
    draws = metrics.group_draws(scores, ["d1", "d9", "d1", "d9", None])
    assert {name: draw.mean for name, draw in draws.items()} == {"d1": 20.0, "d9": 30.0}
    spread = metrics.fairness(draws)
    assert (spread.worst, spread.best, spread.gap.value) == ("d1", "d9", 10.0)
    assert spread.gap.value_ci is not None
    assert 0 <= spread.gap.value_ci[0] <= 10 <= spread.gap.value_ci[1]
    with pytest.raises(ValueError, match="there are 2 groups for 5 partners"):
        metrics.group_draws(scores, ["d1", "d9"])


def test_cross_play_of_two_teams_by_hand():
    payoff = np.array([[4.0, 1.0], [0.5, 3.0]])
    teams = same_traits(["a", "b"], ["ippo", "isac"])
    figures = metrics.cross_play(payoff, teams, teams)
    assert figures.self_play and figures.cross_play and figures.gap and figures.relative_gap
    assert (figures.self_play.mean, figures.cross_play.mean, figures.gap.mean) == (3.5, 0.75, 2.75)
    assert figures.relative_gap.value == pytest.approx(2.75 / 3.5)
    assert (figures.self_play.n, figures.cross_play.n) == (2, 2)
    assert figures.within_algorithm is None
    assert figures.across_algorithms == figures.within_disability
    # Half of the draws are one team twice, which has no cross-play.
    assert figures.cross_play.iqm_ci is None


def test_crossplay_equals_loop_over_pairs():
    rng = np.random.default_rng(0)
    traits = Traits(list("abcdef"), ["ippo", "isac"] * 3, ["d1"] * 3 + ["d9"] * 3)
    matrix = rng.normal(size=(6, 6))
    figures = metrics.cross_play(matrix, traits, traits)
    for name, values, equal in (
        ("within_algorithm", traits.algorithms, True),
        ("across_algorithms", traits.algorithms, False),
        ("within_disability", traits.disabilities, True),
        ("across_disabilities", traits.disabilities, False),
    ):
        pairs = [
            matrix[a, b]
            for a, b in itertools.product(range(6), range(6))
            if a != b and (values[a] == values[b]) == equal
        ]
        figure = getattr(figures, name)
        assert (figure.mean, figure.n) == (pytest.approx(np.mean(pairs)), len(pairs))
        assert figure.iqm == pytest.approx(scipy.stats.trim_mean(pairs, 0.25))


def test_self_play_matches_teams_by_name():
    matrix = np.array([[1.0, 2], [3, 4], [5, 6]])
    rows = Traits(["b", None, "a"], ["ippo", None, "ippo"], ["d1", None, "d1"])
    figures = metrics.cross_play(matrix, rows, same_traits(["a", "b"]))
    assert figures.self_play and figures.cross_play and figures.within_algorithm
    assert (figures.self_play.mean, figures.cross_play.n) == ((2 + 5) / 2, 4)
    assert figures.within_algorithm.n == 2  # pairs of an outsider are neither within nor across
    outsiders = Traits([None] * 3, [None] * 3, [None] * 3)
    apart = metrics.cross_play(matrix, outsiders, same_traits(["a", "b"]))
    assert apart.self_play is apart.gap is None and apart.cross_play is not None
    assert apart.cross_play.generalises_to == "egos and partners"


def test_single_pair_has_no_interval():
    humans = same_traits(list("abcdef"))
    figures = metrics.cross_play(np.array([[9.0, 1, 2, 3, 4, 5]]), same_traits(["a"]), humans)
    assert figures.self_play is not None
    assert (figures.self_play.mean_ci, figures.self_play.generalises_to) == (None, "nothing")
    for figure in (figures.cross_play, figures.gap):
        assert figure is not None and figure.generalises_to == "partners"
        assert figure.mean_ci is not None and figure.mean_ci[0] < figure.mean < figure.mean_ci[1]
    assert figures.relative_gap is not None and figures.relative_gap.value_ci is not None
    two = metrics.cross_play(np.array([[9.0, 1.0]]), same_traits(["a"]), same_traits(["a", "b"]))
    for figure in (two.self_play, two.cross_play, two.gap):
        assert figure is not None
        assert (figure.mean_ci, figure.iqm_ci, figure.generalises_to) == (None, None, "nothing")


def test_relative_gap_needs_positive_self_play():
    teams = same_traits(["a", "b", "c"])
    assert metrics.cross_play(-np.eye(3), teams, teams).relative_gap is None


@pytest.mark.parametrize("repetitions", [200, 2000])
@pytest.mark.slow
def test_intervals_over_teams_cover(repetitions: int):
    """Robot, human and pair effects of one size; self-play 2 higher. 24 teams."""
    names = [f"t{i}" for i in range(24)]
    teams, rng = same_traits(names), np.random.default_rng(0)
    hits = {"self_play": 0, "cross_play": 0, "gap": 0}
    truth = {"self_play": 2.0, "cross_play": 0.0, "gap": 2.0}
    for i in range(repetitions):
        robots, humans, pairs = (rng.normal(size=size) for size in ((24, 1), 24, (24, 24)))
        matrix = robots + humans + pairs + 2 * np.eye(24)
        figures = metrics.cross_play(matrix, teams, teams, resamples=200, seed=i)
        for name in hits:
            low, high = getattr(figures, name).mean_ci
            hits[name] += low <= truth[name] <= high
    for name, count in hits.items():
        assert 0.89 <= count / repetitions <= 0.98, name


def test_normalised_return_is_nan_for_unscorable():
    bounds = Bounds(np.array([100.0, 50, 10]), np.array([0.0, 0, 10]))
    scores = np.array([[50.0, 60, 10], [-10, 25, 10]])
    np.testing.assert_allclose(
        metrics.normalised_return(scores, bounds), [[0.5, 1.2, np.nan], [-0.1, 0.5, np.nan]]
    )
    np.testing.assert_allclose(metrics.regret(scores, bounds), [80.0, 7.5, 0.0])
    prox = metrics.br_prox(scores, bounds)
    assert bounds.scorable.tolist() == [True, True, False]
    assert prox is not None and prox.n == 4
    assert prox.iqm == pytest.approx(iqm(np.array([0.5, 1.0, -0.1, 0.5])))
    covered = metrics.coverage(scores, bounds, epsilon=0.2)
    assert covered is not None
    assert (covered.value, covered.epsilon, covered.n) == (0.5, 0.2, 4)


def test_bounds_are_checked():
    with pytest.raises(ValueError, match=r"best \(1,\) and low \(2,\) differ"):
        Bounds(np.array([1.0]), np.array([0.0, 1.0]))
    with pytest.raises(ValueError, match="a bound is not finite"):
        Bounds(np.array([np.inf]), np.array([0.0]))


def test_worst_partner_is_cross_validated():
    returns = np.array([[[10.0, 10], [0, 8], [4, 6]]])
    worst = metrics.worst_partner(returns)
    assert (worst.index, worst.mean) == (1, 4.0)
    assert worst.crossfit == (8 + 4) / 2  # even chooses the second, odd the third
    assert metrics.worst_partner(returns[:, :, :1]).crossfit is None


def test_cvar_crossfit_equals_its_definition():
    returns = np.random.default_rng(0).normal(size=(3, 25, 4))
    even, odd = returns[:, :, ::2].mean(axis=(0, 2)), returns[:, :, 1::2].mean(axis=(0, 2))

    def tail(choose: np.ndarray, value: np.ndarray) -> float:
        order = np.argsort(choose)
        return (value[order[0]] + value[order[1]] + 0.5 * value[order[2]]) / 2.5

    figure = metrics.cvar_crossfit(returns, 0.1)
    assert figure.value == pytest.approx((tail(even, odd) + tail(odd, even)) / 2)
    with pytest.raises(ValueError, match="2 or more episodes a pair"):
        metrics.cvar_crossfit(returns[:, :, :1])


def test_planted_defect_biased_tail_is_caught():
    returns = np.random.default_rng(0).normal(size=(1, 100, 8))  # all partners are alike
    naive = np.sort(returns.mean(axis=(0, 2)))[:10].mean()
    assert naive < -0.5
    assert abs(metrics.cvar_crossfit(returns, 0.1).value) < 0.15


def test_paired_difference_cancels_common_effects():
    rng = np.random.default_rng(0)
    common = 100 * rng.normal(size=(1, 40))
    a, b = common + rng.normal(size=(1, 40)) + 1.0, common + rng.normal(size=(1, 40))
    figure = metrics.paired_difference(a, b)
    assert figure.mean == pytest.approx((a - b).mean())
    assert figure.mean_ci is not None and figure.p_positive is not None
    assert np.ptp(figure.mean_ci) < 1.5  # apart, the means vary by 30
    assert figure.p_positive > 0.95
    assert figure.partners_better == pytest.approx(np.mean(a > b))
    assert figure.generalises_to == "partners"
    same = metrics.paired_difference(a[:, :1], a[:, :1])
    assert (same.iqm_ci, same.p_positive, same.partners_better) == (None, None, 0.5)
    with pytest.raises(ValueError, match="a has 40 partners and b has 39"):
        metrics.paired_difference(a, b[:, 1:])


def test_rank_stability_separates_order_from_noise():
    rng = np.random.default_rng(0)
    clear = np.arange(5.0)[:, None] + 0.01 * rng.normal(size=(5, 40))
    assert metrics.rank_stability(clear).tau == pytest.approx(1.0)
    assert abs(metrics.rank_stability(rng.normal(size=(30, 400))).tau) < 0.3
    with pytest.raises(ValueError, match="1 egos and 40 partners"):
        metrics.rank_stability(clear[:1])
    with pytest.raises(ValueError, match="all egos have the same scores"):
        metrics.rank_stability(np.ones((3, 4)))


def test_diversity_by_hand():
    # Scaled to the rows (0, 1) and (1, 0).
    diverse = strategies.br_diversity(np.array([[0.0, 5.0], [2.0, 3.0]]))
    assert diverse.log_determinant == pytest.approx(0.0)
    assert (diverse.rank, diverse.participation_ratio) == (2, pytest.approx(2.0))
    twice = strategies.br_diversity(np.array([[0.0, 5.0], [2.0, 3.0], [2.0, 3.0]]))
    assert (twice.log_determinant, twice.rank) == (None, 2)  # singular
    alike = strategies.br_diversity(np.ones((3, 2)))
    assert (alike.rank, alike.participation_ratio) == (0, 0.0)


def test_greedy_subset_maximises_log_determinant():
    features = np.random.default_rng(0).uniform(size=(12, 5))
    phi = strategies.scale_features(features)
    picked = strategies.greedy_subset(features, 4)
    for step in range(1, 5):
        chosen = [phi[[*picked[: step - 1], i]] for i in range(len(phi))]
        gains = [np.linalg.det(rows @ rows.T) for rows in chosen]
        assert int(np.argmax(gains)) == picked[step - 1]
    with pytest.raises(ValueError, match="size is 6; the features have rank 5"):
        strategies.greedy_subset(features, 6)
