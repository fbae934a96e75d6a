"""The Ladder: what it shows, what it keeps to itself, and what a climber gains."""

import dataclasses
from typing import Literal

import numpy as np
import pytest
import scipy.stats

from assistax_board.places.ladder import ladder_release
from evaluation.figures.bootstrap import estimate

RNG = np.random.default_rng(0)
BASE = RNG.normal(900, 30, 60)

# A submitter's robot is a point x, and its mean return with partner p is ease_p + w_p . x. Each w_p
# has a part that all hidden partners share and a part of its own. The submitter tries steps and
# believes the board. The sizes are those of release v1's scratch, from its 16 PPO egos.
PARTNERS = 60  # of panel A, and of panel B
EPISODES = 16
DIMENSIONS = 1000  # directions in which a robot may change; networks have 20,000
BETWEEN_PARTNERS = 3.9  # standard deviations of returns
BY_A_STEP = 2.7
BETWEEN_EPISODES = 13.0

Board = Literal["exact", "ladder"]
Attack = Literal["climb", "gather"]


def test_shown_scores_are_rounded_to_their_error() -> None:
    shown = ladder_release(None, BASE, attempt=1)
    assert shown is not None
    assert shown == pytest.approx(BASE.mean(), abs=BASE.std(ddof=1) / np.sqrt(60))
    assert shown % 2 == 0  # the error is near 4, so the unit is 2
    better = BASE + 20 + np.random.default_rng(2).normal(0, 10, 60)
    gains = np.linspace(0, 0.3, 50)
    assert len({ladder_release(BASE, better + gain, attempt=2) for gain in gains}) <= 2


@pytest.mark.parametrize("attempt", [2, 20])
def test_ladder_shows_only_paired_t_test_gains(attempt: int) -> None:
    """At attempt t the test is at 5% / (t (t + 1)): 0.8% at the second, 0.012% at the 20th."""
    noise = np.random.default_rng(1).normal(0, 10, 60)
    shown = []
    for gain in np.linspace(-2, 8, 41):
        new = BASE + gain + noise
        p = scipy.stats.ttest_rel(new, BASE, alternative="greater").pvalue
        shown.append(ladder_release(BASE, new, attempt=attempt) is not None)
        assert shown[-1] == (p < 0.05 / (attempt * (attempt + 1)))
    assert 0 < sum(shown) < 41


def test_ladder_ignores_luck_in_95_percent() -> None:
    """100 seasons of 50 attempts, none of which is better than the first."""
    rng = np.random.default_rng(3)
    fooled = 0
    for _ in range(100):
        first, *others = BASE + rng.normal(0, 4, (50, 60))
        answers = (ladder_release(first, scores, attempt=2 + i) for i, scores in enumerate(others))
        fooled += any(answer is not None for answer in answers)
    assert fooled <= 10


@dataclasses.dataclass(frozen=True)
class Attacked:
    """What a submitter gained over where it began, in points of return."""

    shown: float  # on panel A, as the board says
    gain_b: float  # on panel B, the truth
    half_width: float  # of the 95% interval of the last robot's mean on panel B


def attack(how: Attack, board: Board, attempts: int, shared: float, seed: int) -> Attacked:
    """Let one submitter attack.

    Args:
        how: "climb" tries a step from the best robot so far and keeps it if the board shows more;
            "gather" tries steps from where it began and takes all those together that it did.
        board: "exact" shows every score, "ladder" what the Ladder releases.
        attempts: how many the submitter has.
        shared: part of a step's variance that all hidden partners have in common.
        seed: of everything.
    """
    rng = np.random.default_rng(seed)
    common = rng.normal(size=DIMENSIONS)
    own = rng.normal(size=(2, PARTNERS, DIMENSIONS))
    weights = BY_A_STEP * (np.sqrt(shared) * common + np.sqrt(1 - shared) * own)
    ease = rng.normal(0, BETWEEN_PARTNERS, (2, PARTNERS))

    def play(robot: np.ndarray, panel: int) -> np.ndarray:
        noise = rng.normal(0, BETWEEN_EPISODES / np.sqrt(EPISODES), PARTNERS)
        return ease[panel] + weights[panel] @ robot + noise

    best = kept = np.zeros(DIMENSIONS)
    best_scores = play(best, 0)
    first = best_shown = answer_of(board, None, best_scores, 1) or 0.0
    for attempt in range(2, attempts + 1):
        step = rng.normal(size=DIMENSIONS) / np.sqrt(DIMENSIONS)
        scores = play(kept + step if how == "climb" else step, 0)
        shown = answer_of(board, best_scores, scores, attempt)
        bar = first if how == "gather" and board == "exact" else best_shown
        if shown is not None and shown > bar:
            kept = kept + step
            if shown > best_shown:
                best_scores, best_shown = scores, shown
    on_b = estimate(play(kept, 1)[None], resamples=500, seed=seed).mean_ci
    width = (on_b[1] - on_b[0]) / 2 if on_b else 0.0
    return Attacked(best_shown - first, float((weights[1] @ kept).mean()), width)


def answer_of(board: Board, best: np.ndarray | None, new: np.ndarray, attempt: int) -> float | None:
    if board == "exact":
        return float(new.mean())
    return ladder_release(best, new, attempt=attempt)


@pytest.mark.parametrize("shared", [0.0, 0.02])
def test_thousand_attempts_gain_less_than_half_width(shared: float) -> None:
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


def test_other_partners_are_refused() -> None:
    with pytest.raises(ValueError, match=r"expected \(60,\), as the best has"):
        ladder_release(BASE, BASE[:59], attempt=2)
    with pytest.raises(ValueError, match="2 or more"):
        ladder_release(None, BASE[:1], attempt=1)
    with pytest.raises(ValueError, match="not finite"):
        ladder_release(None, np.array([1.0, np.nan]), attempt=1)
