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
