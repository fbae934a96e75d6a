"""Rank intervals: what must follow from the data, and how often they are right."""

import numpy as np
import pytest

from assistax_zoo.service.statistics_ranks import Ranks, rank_methods


def played(
    truth: np.ndarray, rng: np.random.Generator, *, seeds: int = 5, partners: int = 30
) -> list[np.ndarray]:
    """Scores [S, P] of methods: the truth, the partner's ease, the seed's luck, and the pair's."""
    ease = rng.normal(0, 3, partners)
    return [
        mean + ease + rng.normal(0, 1, (seeds, 1)) + rng.normal(0, 2, (seeds, partners))
        for mean in truth
    ]


def true_ranks(truth: np.ndarray) -> np.ndarray:
    return 1 + (truth[:, None] > truth[None]).sum(axis=0)


def covers(ranks: Ranks, truth: np.ndarray) -> bool:
    own = true_ranks(truth)
    return bool(((ranks.places <= own) & (own <= ranks.lowest)).all())


def test_methods_far_apart_have_one_rank_each() -> None:
    ranks = rank_methods(played(np.array([0.0, 30.0, 10.0, 20.0]), np.random.default_rng(0)))
    assert ranks.places.tolist() == ranks.lowest.tolist() == [4, 1, 3, 2]


def test_a_method_shares_the_place_of_its_copy() -> None:
    scores = played(np.array([0.0, 20.0]), np.random.default_rng(1))
    ranks = rank_methods([*scores, scores[1]])
    assert ranks.places.tolist() == [3, 1, 1]
    assert ranks.lowest.tolist() == [3, 2, 2]


def test_one_method_alone_is_first() -> None:
    ranks = rank_methods(played(np.array([0.0]), np.random.default_rng(2)))
    assert (ranks.places.tolist(), ranks.lowest.tolist()) == ([1], [1])


def test_partners_that_are_hard_for_everybody_do_not_blur_the_order() -> None:
    """Paired: both methods meet the same partners, whose ease varies a hundred times the gap."""
    rng = np.random.default_rng(3)
    ease = rng.normal(0, 100, 40)
    scores = [ease + gap + rng.normal(0, 0.5, (4, 40)) for gap in (0.0, 1.0)]
    assert rank_methods(scores).places.tolist() == [2, 1]
    shuffled = [scores[0], scores[1][:, rng.permutation(40)]]
    assert rank_methods(shuffled).places.tolist() == [1, 1]


def test_what_follows_from_two_claims_is_claimed() -> None:
    """A noisy loser: both links of the chain are certain, so its ends are apart as well."""
    better = rank_methods(played(np.array([0.0, 15.0, 30.0]), np.random.default_rng(4))).better
    assert not np.diagonal(better @ better).any()
    assert (better >= (better.astype(int) @ better.astype(int) > 0)).all()


def test_equal_seeds_give_equal_ranks() -> None:
    scores = played(np.linspace(0, 4, 6), np.random.default_rng(5))
    first, second = (rank_methods(scores, seed=7).better for _ in range(2))
    assert (first == second).all()


@pytest.mark.parametrize("seeds", [1, 3, 10])
def test_all_ranks_are_right_at_once_in_95_of_100_boards(seeds: int) -> None:
    """Six methods, three of them equal: 300 boards, so 0.05 is exceeded by 3 errors at 0.09."""
    truth = np.array([0.0, 0.0, 0.0, 2.0, 2.5, 9.0])
    rng = np.random.default_rng(6)
    wrong = 0
    for _ in range(300):
        scores = played(truth, rng, seeds=seeds)
        if seeds == 1:  # a single robot is itself the method: its luck is no error
            scores = [mean + rng.normal(0, 2, (1, 30)) for mean in truth]
        wrong += not covers(rank_methods(scores, resamples=400), truth)
    assert wrong / 300 <= 0.09
    assert rank_methods(played(truth, rng, seeds=10)).places[5] == 1  # and it is not idle


def test_intervals_without_a_common_bar_would_be_wrong_too_often() -> None:
    """The planted defect: pairwise tests at 5%, each for itself, on 8 equal methods."""
    truth, rng = np.zeros(8), np.random.default_rng(8)
    together, alone = 0, 0
    for _ in range(100):
        scores = played(truth, rng)
        together += not covers(rank_methods(scores, resamples=400), truth)
        pairs = [rank_methods([scores[0], other], resamples=400) for other in scores[1:]]
        alone += any(pair.better.any() for pair in pairs)
    assert together <= 10
    assert alone >= 15


def test_different_partners_are_refused() -> None:
    with pytest.raises(ValueError, match="the methods have 3, 4 partners"):
        rank_methods([np.zeros((1, 3)), np.zeros((1, 4))])
    with pytest.raises(ValueError, match="2 or more"):
        rank_methods([np.zeros((2, 1))])
