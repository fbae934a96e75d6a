"""The time, handed in wherever it is needed, so that tests can let it jump."""

import time
from collections.abc import Callable
from datetime import UTC, datetime

Clock = Callable[[], float]  # seconds since 1970

system_clock: Clock = time.time


def seconds_of(date: datetime) -> float:
    """Return a date as seconds since 1970; without a zone it is UTC."""
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
