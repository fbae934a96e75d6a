"""How much of a hidden panel a team is told: the parameter-free Ladder (Blum and Hardt, ICML 2015).

A team that may try often can climb on luck: it keeps whatever change the board calls better, and
after a thousand attempts it has learnt the panel and not the task. The Ladder shows a score only
where it beats the team's last shown one by more than chance allows, and shows it rounded. Any
other attempt is answered with silence, which tells next to nothing.

Blum and Hardt ask for one standard error of the paired losses. Here the bar is higher, because it
must hold for all attempts together: 5% is the chance that any answer in a whole season is luck, and
attempt t may spend a share 1 / (t (t + 1)) of it. The sum of all shares is 1, however many follow.
What that buys is in docs/board.md.
"""

import math

import numpy as np
import scipy.stats

CONFIDENCE = 0.95


def ladder_release(
    best: np.ndarray | None, new: np.ndarray, *, attempt: int, confidence: float = CONFIDENCE
) -> float | None:
    """Return the rounded mean to show of an attempt; None for silence.

    Args:
        best: mean return with each partner [P] of the attempt that was shown last; None if the
            team was shown nothing yet. Neither array ever leaves the server.
        new: mean return of this attempt with the same partners, in the same order.
        attempt: number of this attempt among the team's scored ones on this panel, from 1.
        confidence: in all answers of the season together.

    Raises:
        ValueError: no such attempt, fewer than two partners, other partners than the best's, or
            a score that is not finite.
    """
    _check(best, new)
    if attempt < 1:
        raise ValueError(f"attempt is {attempt}; the first is 1")
    if best is None:
        return _round(new.mean(), standard_error(new))
    gains = new - best
    error = standard_error(gains)
    share = (1 - confidence) / (attempt * (attempt + 1))
    if gains.mean() <= scipy.stats.t.isf(share, gains.size - 1) * error:
        return None
    return _round(new.mean(), error)


def standard_error(values: np.ndarray) -> float:
    """Return the standard error of the mean of values [n]."""
    return float(values.std(ddof=1) / math.sqrt(values.size))


def _round(value: float, error: float) -> float:
    """Round to 1, 2 or 5 times a power of ten, the largest of them within the error.

    Digits below the error say nothing of the method, but they tell attempts apart.
    """
    if error <= 0:
        return float(value)
    power = 10.0 ** math.floor(math.log10(error))
    unit = max(step * power for step in (1, 2, 5) if step * power <= error * (1 + 1e-12))
    return round(float(value) / unit) * unit


def _check(best: np.ndarray | None, new: np.ndarray) -> None:
    expected = "[partners], 2 or more" if best is None else f"{best.shape}, as the best has"
    if new.ndim != 1 or new.size < 2 or (best is not None and best.shape != new.shape):
        raise ValueError(f"new has shape {new.shape}; expected {expected}")
    if not np.isfinite(new).all():
        raise ValueError("scores are not finite; a broken episode counts 0 from then on")
