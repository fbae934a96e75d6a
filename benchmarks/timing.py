"""Timing that every measurement shares: repeats, and the number of calls that fits a time."""

import time
from collections.abc import Callable
from typing import Any

import jax

REPEATS = 3  # of each measurement; the median is the figure


def timed(function: Callable[[int], Any], calls: int) -> float:
    """Return the seconds of `function(calls)`, until its arrays are ready."""
    began = time.perf_counter()
    jax.block_until_ready(function(calls))
    return time.perf_counter() - began


def calls_within(function: Callable[[int], Any], seconds: float) -> int:
    """Return the number of calls that take about `seconds`, at least 1."""
    return max(1, int(seconds / timed(function, 1)))


def check_seconds(seconds: float) -> None:
    """Refuse a measuring time that is not above 0 and below an hour.

    Raises:
        ValueError: It is not.
    """
    if not 0 < seconds < 3600:
        raise ValueError(f"seconds is {seconds}; allowed is more than 0 and less than 3600")
