"""The rows of a board against the metrics they are made of, and small boards known by hand."""

import numpy as np
import pytest

from assistax_board.places.boards import Method, Panel, board_rows, worst_tenth
from evaluation.figures.metrics import Bounds, zero_shot

PARTNERS = 20
DISABILITIES = tuple(f"d{1 + i % 4}" for i in range(PARTNERS))


def method(name: str, mean: float, seed: int, seeds: int = 3, episodes: int = 4) -> Method:
    rng = np.random.default_rng(seed)
    return Method(name, rng.normal(mean, 5.0, (seeds, PARTNERS, episodes)))


def test_rows_are_sorted_and_share_places() -> None:
    methods = [method("low", 100, 0), method("high", 150, 1), method("twin", 150, 1)]
    reference = Method("reference", methods[1].returns, competes=False)
    rows = board_rows([*methods, reference], Panel(DISABILITIES))
    places = {row.name: (row.place, row.lowest) for row in rows if row.name != "reference"}
    assert places == {"high": (1, 2), "twin": (1, 2), "low": (3, 3)}
    assert [row.name for row in rows][-1] == "low"
    assert [row.place for row in rows if row.name == "reference"] == [None], "it does not compete"


def test_figures_are_those_of_the_scores() -> None:
    single = method("one", 100, 2)
    [row] = board_rows([single], Panel(DISABILITIES))
    scores = single.returns.mean(axis=2)
    assert row.m_test.mean == pytest.approx(scores.mean())
    assert row.m_test.mean_ci is not None
    assert row.m_test.mean_ci[0] < scores.mean() < row.m_test.mean_ci[1]
    assert row.fairness is not None
    groups = [
        scores[:, np.array(DISABILITIES) == name].mean() for name in sorted(set(DISABILITIES))
    ]
    assert row.fairness.gap.value == pytest.approx(max(groups) - min(groups))
    assert row.cvar is not None
    assert row.cvar.value < scores.mean()


def test_normalised_random_is_0_best_response_1() -> None:
    low, best = np.full(PARTNERS, 10.0), np.full(PARTNERS, 110.0)
    bounds = Bounds(best, low)
    for level, expected in ((10.0, 0.0), (110.0, 1.0), (60.0, 0.5)):
        played = Method("x", np.full((2, PARTNERS, 2), level))
        [row] = board_rows([played], Panel(DISABILITIES, bounds))
        assert row.normalised is not None
        assert row.normalised.mean == pytest.approx(expected)


def test_worst_tenth_bounds_one_partner_in_ten() -> None:
    scores = np.random.default_rng(4).permutation(np.arange(40.0))[None]
    worst = worst_tenth(scores)
    assert (scores <= worst.value).sum() == 4
    assert worst.value_ci is not None
    assert worst.value_ci[0] <= worst.value <= worst.value_ci[1]


def test_method_lacking_partners_is_refused() -> None:
    short = Method("short", np.zeros((1, PARTNERS - 1, 4)))
    with pytest.raises(ValueError, match="short has returns of shape"):
        board_rows([method("x", 1, 5), short], Panel(DISABILITIES))
    with pytest.raises(ValueError, match="no methods"):
        board_rows([], Panel(DISABILITIES))


def test_missing_data_leaves_gaps() -> None:
    [row] = board_rows([method("x", 1, 3, episodes=1)], Panel((None,) * PARTNERS))
    assert (row.cvar, row.fairness, row.normalised) == (None, None, None)
    methods = [Method(name, np.full((1, 1, 4), level)) for name, level in (("a", 1.0), ("b", 2.0))]
    rows = board_rows(methods, Panel(("d1",)))
    assert [(row.name, row.place, row.m_test.mean) for row in rows] == [
        ("b", None, 2.0),
        ("a", None, 1.0),
    ]


def test_unlike_seeds_keep_other_places() -> None:
    means = (982, 890, 700, 540, 410, 300, 160, 19)
    methods = [method(f"m{mean}", mean, mean) for mean in means]
    odd = method("odd", 500, 7, seeds=2)
    unlike = Method("odd", odd.returns + np.array([-400.0, 400.0])[:, None, None])
    rows = board_rows([*methods, unlike], Panel(DISABILITIES))
    places = {row.name: row.place for row in rows}
    assert [places[f"m{mean}"] for mean in means] == list(range(1, 9))
    assert places["odd"] == 1


def test_a_large_group_counts_no_more_than_a_small_one() -> None:
    """The first robot suits the family that most partners are of, the second one both."""
    groups = ("known families",) * 15 + ("unseen family",) * 5
    one_sided, fair = method("one-sided", 0, 8), method("fair", 70, 9)
    level = np.where(np.array(groups) == "unseen family", 0.0, 100.0)
    one_sided = Method("one-sided", one_sided.returns + level[:, None])
    rows = board_rows([one_sided, fair], Panel(DISABILITIES, groups=groups))
    assert [(row.name, row.place) for row in rows] == [("fair", 1), ("one-sided", 2)]
    assert rows[1].m_test.mean == pytest.approx(50.0, abs=2.0)
    assert one_sided.returns.mean() > fair.returns.mean(), "by the plain mean it was the other way"
    own = zero_shot(one_sided.returns.mean(axis=2), ["test"] * PARTNERS, groups)
    assert own.m_test is not None and rows[1].m_test.mean == pytest.approx(own.m_test.mean)
    assert rows[1].m_test.mean_ci == own.m_test.mean_ci
    assert rows[1].by_group == own.by_group
    assert not board_rows([fair], Panel(DISABILITIES))[0].by_group


def test_normalised_returns_count_groups_alike() -> None:
    groups = ("known families",) * 16 + ("unseen family",) * 4
    bounds = Bounds(np.full(PARTNERS, 100.0), np.zeros(PARTNERS))
    played = Method("x", np.repeat([[[100.0]], [[0.0]]], [16, 4], axis=0).reshape(1, PARTNERS, 1))
    [row] = board_rows([played], Panel(DISABILITIES, bounds, groups))
    assert row.normalised is not None and row.normalised.mean == pytest.approx(0.5)
