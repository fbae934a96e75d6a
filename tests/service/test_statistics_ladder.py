"""The Ladder: what it shows, what it keeps to itself, and what a climber gains."""

import numpy as np
import pytest
import scipy.stats

from assistax_zoo.service.statistics_ladder import ladder_release

RNG = np.random.default_rng(0)
BASE = RNG.normal(900, 30, 60)


def test_the_first_attempt_is_shown_rounded_to_its_error() -> None:
    shown = ladder_release(None, BASE)
    assert shown is not None
    assert shown == pytest.approx(BASE.mean(), abs=BASE.std(ddof=1) / np.sqrt(60))
    assert shown % 2 == 0  # the error is near 4, so the unit is 2


def test_only_what_a_paired_t_test_finds_is_shown() -> None:
    noise = np.random.default_rng(1).normal(0, 10, 60)
    for gain in np.linspace(-5, 5, 21):
        new = BASE + gain + noise
        p = scipy.stats.ttest_rel(new, BASE, alternative="greater").pvalue
        assert (ladder_release(BASE, new) is not None) == (p < 0.05)


def test_the_same_robot_again_is_not_better() -> None:
    assert ladder_release(BASE, BASE.copy()) is None
    assert ladder_release(BASE, BASE - 1.0) is None


def test_digits_below_the_error_are_not_shown() -> None:
    noise = np.random.default_rng(2).normal(0, 10, 60)
    shown = {ladder_release(BASE, BASE + 20 + tiny + noise) for tiny in np.linspace(0, 0.3, 50)}
    assert len(shown) <= 2


def test_other_partners_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(60,\), as the best has"):
        ladder_release(BASE, BASE[:59])
    with pytest.raises(ValueError, match="2 or more"):
        ladder_release(None, BASE[:1])
    with pytest.raises(ValueError, match="not finite"):
        ladder_release(None, np.array([1.0, np.nan]))
