"""How many requests an address or a token may make, counted in memory."""

import math
import threading
import time

from limits import RateLimitItem
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter

from assistax_board.problems import Problem

FORGET_SECONDS = 1.0  # between two times that expired counts are dropped


class Limiter:
    """Counts requests in sliding windows."""

    def __init__(self) -> None:
        self._counts = _Counts()
        self._windows = SlidingWindowCounterRateLimiter(self._counts)

    def hit(self, rate: RateLimitItem, who: str) -> None:
        """Count a request.

        Raises:
            Problem: It is one too many.
        """
        if not self._windows.hit(rate, who):
            wait = self._windows.get_window_stats(rate, who).reset_time - time.time()
            message = f"more than {rate}; wait and try again"
            raise Problem("too_many_requests", message, max(1, math.ceil(wait)))

    def left(self, rate: RateLimitItem, who: str) -> int:
        """Return how many requests may still be made now."""
        return self._windows.get_window_stats(rate, who).remaining


class _Running(threading.Timer):
    """Replaces the timer of `limits`, which would start a thread.

    Requests would start a new thread each hundredth of a second, which looks through all counts.
    On a busy machine a request would wait for its start.
    """

    def is_alive(self) -> bool:
        """Return True."""
        return True


class _Counts(MemoryStorage):
    """Counts that drop expired entries when another request is counted."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._forgot_at = time.time()
        super().__init__()
        self.timer.join()
        self.timer = _Running(0.0, self._forget)

    def incr(self, key: str, expiry: float, amount: int = 1) -> int:
        """Count."""
        with self._lock:
            self._forget()
            return super().incr(key, expiry, amount)

    def _forget(self) -> None:
        """Drop expired counts, once in a while; the caller has the lock."""
        now = time.time()
        if now - self._forgot_at > FORGET_SECONDS:
            self._forgot_at = now
            for key in [key for key, until in self.expirations.items() if until <= now]:
                self.clear(key)
                self.expirations.pop(key, None)
