"""The adaptation slope against least squares by SciPy, and robots that must get no credit."""

import numpy as np
import pytest
from scipy import stats

from evaluation.figures.metrics.adaptation import Adaptation, adaptation

PERSONS = 60


def _liked(seed: int, robots: int = 1, episodes: int = 4, persons: int = PERSONS) -> np.ndarray:
    values = np.exp(np.random.default_rng(seed).normal(1.4, 0.55, persons))
    return np.broadcast_to(values[None, :, None], (robots, persons, episodes)).copy()


def _found(
    liked: np.ndarray, done: np.ndarray, within: np.ndarray | float, **options: int
) -> Adaptation:
    shares = np.where(np.isfinite(done), within, np.nan)
    found = adaptation(liked, done, shares, **options)
    assert found is not None
    return found


@pytest.mark.parametrize("slope", [1.0, 0.4, 0.0, -0.3])
def test_slope_is_that_of_least_squares_over_persons(slope: float) -> None:
    rng = np.random.default_rng(11)
    liked = _liked(3)
    done = np.exp(0.3 + slope * np.log(liked) + rng.normal(0.0, 0.3, liked.shape))
    done[0, 5] = np.nan  # never touched
    done[0, 6, :3] = np.nan  # touched in one episode
    found = _found(liked, done, 0.9)
    x, y = np.log(liked[0, :, 0]), np.nanmean(np.log(done[0, np.arange(PERSONS) != 5]), axis=1)
    expected = stats.linregress(np.delete(x, 5), y)
    assert found.slope.value == pytest.approx(expected.slope, rel=1e-6, abs=1e-9)
    assert found.plain == pytest.approx(expected.slope, rel=1e-6, abs=1e-9)
    assert found.slope.n == PERSONS - 1 and found.slope.generalises_to == "partners"
    ratio = np.exp((y - np.delete(x, 5)).mean())
    assert found.done_to_liked == pytest.approx(ratio)
    # Resampling persons gives about the interval of the formula.
    assert found.slope.value_ci is not None
    low, high = found.slope.value_ci
    assert low < found.slope.value < high
    assert high - low == pytest.approx(2 * 1.96 * expected.stderr, rel=0.35)


def test_interval_holds_the_true_slope_as_often_as_it_says() -> None:
    held = 0
    for seed in range(200):
        rng = np.random.default_rng(1000 + seed)
        liked = _liked(seed, episodes=1)
        done = np.exp(0.4 * np.log(liked) + rng.normal(0.0, 0.3, liked.shape))
        ends = _found(liked, done, 0.9, resamples=400, seed=seed).slope.value_ci
        assert ends is not None
        held += ends[0] <= 0.4 <= ends[1]
    assert 0.88 <= held / 200 <= 0.99


def test_robot_that_swings_between_half_and_double_gets_no_credit() -> None:
    """Its geometric mean is just what each person likes, and no touch of it is."""
    liked = _liked(4)
    swings = np.where(np.arange(500) % 2, 0.5, 2.0)
    done = liked * np.exp(np.log(swings).mean())
    within = float(np.mean(np.abs(np.log(swings)) <= np.log(1.5)))
    found = _found(liked, done, within)
    assert found.plain == pytest.approx(1.0)
    assert (found.slope.value, found.slope.value_ci, found.credited) == (0.0, (0.0, 0.0), 0)


def test_a_robot_that_listens_is_credited_beside_one_that_swings() -> None:
    liked = _liked(5, robots=2)
    within = np.where(np.arange(2)[:, None, None] == 0, 0.8, 0.1) * np.ones(liked.shape)
    found = _found(liked, liked.copy(), within)
    assert found.slope.value == pytest.approx(0.5) and found.credited == 1
    assert found.within == pytest.approx(0.45)
    assert found.slope.generalises_to == "seeds and partners"


def test_no_credit_does_not_hide_a_slope_against_the_wish() -> None:
    liked = _liked(6)
    found = _found(liked, 1.0 / liked, 0.2)
    assert found.slope.value == pytest.approx(-1.0) and found.credited == 0


def test_persons_who_are_not_touched_lower_the_share_within() -> None:
    """A robot that turns to half of the persons alone does not look as if it served all."""
    liked = _liked(7)
    done = liked.copy()
    done[0, ::2] = np.nan
    found = _found(liked, done, 1.0)
    assert found.plain == pytest.approx(1.0) and found.within == pytest.approx(0.5)
    assert found.slope.value == 0.0


def test_no_slope_without_several_persons_or_several_wishes() -> None:
    liked = _liked(8)
    some = np.full(liked.shape, 0.9)
    assert adaptation(liked, np.full(liked.shape, np.nan), some) is None
    assert adaptation(liked[:, :2], liked[:, :2], some[:, :2]) is None
    assert adaptation(np.full(liked.shape, 4.0), liked, some) is None
    turns = liked * np.array([1.0, 2.0, 4.0, 8.0])  # a network plays under several preferences
    assert adaptation(turns, liked, some) is None
