"""How far a submitter climbs by a board's answers alone, with the Ladder and without.

A robot is a point x, and its mean return with partner p is linear in it: ease_p + w_p . x. Each
w_p has a part that all partners of the hidden release share and a part of its own, so that a step
in a random direction helps some partners and harms others. The submitter knows nothing: all that it
can do is to try steps and to believe the board. Nothing bounds x and no step has a price, which no
real robot enjoys, so real submitters gain less.

The sizes are those of release v1's scratch, from its 16 PPO egos: how far two seeds of one method
differ with one partner, how much two episodes of a pair differ, and partners from each other.
"""

import dataclasses
import typing
from typing import Literal

import numpy as np

from assistax_board.places.ladder import ladder_release
from evaluation.figures.bootstrap import estimate

PARTNERS = 60  # of panel A, and of panel B
EPISODES = 16
DIMENSIONS = 1000  # directions in which a robot may change; networks have 20,000
BETWEEN_PARTNERS = 3.9  # standard deviations of returns
BY_A_STEP = 2.7
BETWEEN_EPISODES = 13.0

# What a board shows: every score; what beats the best, each attempt tested at 5%; or the Ladder.
Board = Literal["exact", "each", "ladder"]
Attack = Literal["climb", "gather"]


@dataclasses.dataclass(frozen=True)
class Attacked:
    """What a submitter gained over where it began, in points of return."""

    shown: float  # on panel A, as the board says
    gain_b: float  # on panel B, the truth
    half_width: float  # of the 95% interval of the last robot's mean on panel B
    answers: int  # how often the board showed an improvement


def attack(how: Attack, board: Board, attempts: int, shared: float, seed: int) -> Attacked:
    """Let one submitter attack.

    Args:
        how: "climb" tries a step from the best robot so far and keeps it if the board shows more;
            "gather" tries steps from where it began and takes all those together that it did.
        board: what the board shows.
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
    first = best_shown = _answer(board, None, best_scores, 1) or 0.0
    answers = 0
    for attempt in range(2, attempts + 1):
        step = rng.normal(size=DIMENSIONS) / np.sqrt(DIMENSIONS)
        scores = play(kept + step if how == "climb" else step, 0)
        shown = _answer(board, best_scores, scores, attempt)
        bar = first if how == "gather" and board == "exact" else best_shown
        if shown is not None and shown > bar:
            kept, answers = kept + step, answers + 1
            if shown > best_shown:
                best_scores, best_shown = scores, shown
    on_b = estimate(play(kept, 1)[None], resamples=500, seed=seed).mean_ci
    width = (on_b[1] - on_b[0]) / 2 if on_b else 0.0
    return Attacked(best_shown - first, float((weights[1] @ kept).mean()), width, answers)


def _answer(board: Board, best: np.ndarray | None, new: np.ndarray, attempt: int) -> float | None:
    if board == "exact":
        return float(new.mean())
    if board == "each":
        return ladder_release(best, new, attempt=1, confidence=0.9)  # 10% / (1 * 2)
    return ladder_release(best, new, attempt=attempt)


def attack_all(attempts: int, submitters: int) -> list[dict[str, float | str]]:
    """Return one row for each attack, board and shared part: means over submitters."""
    rows: list[dict[str, float | str]] = []
    for shared in (0.0, 0.02, 0.1):
        for how in typing.get_args(Attack):
            for board in typing.get_args(Board):
                results = [attack(how, board, attempts, shared, seed) for seed in range(submitters)]
                means = {
                    field.name: float(np.mean([getattr(result, field.name) for result in results]))
                    for field in dataclasses.fields(Attacked)
                }
                largest = max(result.gain_b for result in results)
                row = {"shared": shared, "attack": how, "board": board, **means}
                rows.append({**row, "largest_gain_b": largest})
    return rows
