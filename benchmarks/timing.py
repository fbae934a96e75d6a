"""What every measurement shares: repeats, and calls that are as many as fit a time."""

import time
from collections.abc import Callable
from typing import Any

import jax

REPEATS = 3  # of each measurement; the median is the figure


def timed(function: Callable[[int], Any], calls: int) -> float:
    """Return the seconds that `function(calls)` takes, until its arrays are there."""
    began = time.perf_counter()
    jax.block_until_ready(function(calls))
    return time.perf_counter() - began


def calls_within(function: Callable[[int], Any], seconds: float) -> int:
    """Return how many calls take about `seconds`, and at least one."""
    return max(1, int(seconds / timed(function, 1)))


def check_seconds(seconds: float) -> None:
    """Refuse a measuring time that is none.

    Raises:
        ValueError: It is not above 0 and below an hour.
    """
    if not 0 < seconds < 3600:
        raise ValueError(f"seconds is {seconds}; allowed is more than 0 and less than 3600")
