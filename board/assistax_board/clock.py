"""The time, handed in wherever it is needed, so that tests can let it jump."""

import time
from collections.abc import Callable
from datetime import UTC, datetime

Clock = Callable[[], float]  # seconds since 1970

JUMP_SECONDS, STANDS_SECONDS = 10.0, 60.0  # what is a jump, and how long it must stand to count


class SteadyClock:
    """The machine's clock, in which a jump counts when it has stood for a minute.

    By one wrong reading a season would be closed, or its partners revealed, for good.
    """

    def __init__(self, wall: Clock = time.time, steady: Clock = time.monotonic) -> None:
        self._wall, self._steady = wall, steady
        self._ahead = wall() - steady()  # of the steady clock, which nobody sets
        self._read = self._ahead, steady()  # as it was read last, and since when

    def __call__(self) -> float:
        now = self._steady()
        ahead = self._wall() - now
        if abs(ahead - self._read[0]) > JUMP_SECONDS:
            self._read = ahead, now
        if abs(ahead - self._ahead) < JUMP_SECONDS or now - self._read[1] > STANDS_SECONDS:
            self._ahead = ahead
        return now + self._ahead


system_clock: Clock = SteadyClock()


def date_of(seconds: float) -> str:
    """Return seconds since 1970 as a date in UTC, such as 2026-12-01T12:00:00+00:00."""
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="seconds")


def seconds_of(date: datetime) -> float:
    """Return a date as seconds since 1970; without a zone it is UTC."""
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()
