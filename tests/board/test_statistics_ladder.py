"""The Ladder: what it shows, what it keeps to itself, and what a climber gains."""

import numpy as np
import pytest
import scipy.stats

from assistax_board.places.ladder import ladder_release
from benchmarks.ladder import attack

RNG = np.random.default_rng(0)
BASE = RNG.normal(900, 30, 60)


def test_the_first_attempt_is_shown_rounded_to_its_error() -> None:
    shown = ladder_release(None, BASE, attempt=1)
    assert shown is not None
    assert shown == pytest.approx(BASE.mean(), abs=BASE.std(ddof=1) / np.sqrt(60))
    assert shown % 2 == 0  # the error is near 4, so the unit is 2


@pytest.mark.parametrize("attempt", [2, 20])
def test_only_what_a_paired_t_test_finds_is_shown(attempt: int) -> None:
    """At attempt t the test is at 5% / (t (t + 1)): 0.8% at the second, 0.012% at the 20th."""
    noise = np.random.default_rng(1).normal(0, 10, 60)
    shown = []
    for gain in np.linspace(-2, 8, 41):
        new = BASE + gain + noise
        p = scipy.stats.ttest_rel(new, BASE, alternative="greater").pvalue
        shown.append(ladder_release(BASE, new, attempt=attempt) is not None)
        assert shown[-1] == (p < 0.05 / (attempt * (attempt + 1)))
    assert 0 < sum(shown) < 41


def test_a_team_that_only_has_luck_is_shown_nothing_in_95_of_100_seasons() -> None:
    """100 seasons of 50 attempts, none of which is better than the first."""
    rng = np.random.default_rng(3)
    fooled = 0
    for _ in range(100):
        first, *others = BASE + rng.normal(0, 4, (50, 60))
        answers = (ladder_release(first, scores, attempt=2 + i) for i, scores in enumerate(others))
        fooled += any(answer is not None for answer in answers)
    assert fooled <= 10


@pytest.mark.parametrize("shared", [0.0, 0.02])
def test_a_thousand_attempts_gain_less_than_a_half_width_on_panel_b(shared: float) -> None:
    for how in ("climb", "gather"):
        attacked = attack(how, "ladder", 1000, shared, seed=0)
        assert attacked.gain_b < attacked.half_width
        assert attacked.shown < 5.0  # exact answers let 30 or more be shown, see below


def test_a_board_that_shows_every_score_is_climbed() -> None:
    """The planted defect: exact answers. Luck fills panel A, and what is shared leaks into B."""
    luck = attack("climb", "exact", 1000, 0.0, seed=0)
    assert luck.shown > 10 * 1.3
    leak = attack("climb", "exact", 1000, 0.02, seed=0)
    assert leak.gain_b > 2 * leak.half_width


def test_the_same_robot_again_is_not_better() -> None:
    assert ladder_release(BASE, BASE.copy(), attempt=2) is None
    assert ladder_release(BASE, BASE - 1.0, attempt=2) is None


def test_digits_below_the_error_are_not_shown() -> None:
    noise = np.random.default_rng(2).normal(0, 10, 60)
    shown = {
        ladder_release(BASE, BASE + 20 + tiny + noise, attempt=2)
        for tiny in np.linspace(0, 0.3, 50)
    }
    assert len(shown) <= 2


def test_other_partners_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(60,\), as the best has"):
        ladder_release(BASE, BASE[:59], attempt=2)
    with pytest.raises(ValueError, match="2 or more"):
        ladder_release(None, BASE[:1], attempt=1)
    with pytest.raises(ValueError, match="not finite"):
        ladder_release(None, np.array([1.0, np.nan]), attempt=1)
