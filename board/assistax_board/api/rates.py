"""How many requests an address or a token may make, counted by all servers together.

Each server counts in its own memory, so that nobody who reads waits for the database. Once a
second, while there are requests, it adds its counts to the database and learns those of the others.
Who asks is a keyed hash there: an address is nobody else's business.
"""

import contextlib
import hashlib
import hmac
import math
import threading
import time
from collections import Counter
from typing import Any

import sqlalchemy as sa
from limits import RateLimitItem
from limits.storage import MemoryStorage
from limits.strategies import SlidingWindowCounterRateLimiter
from sqlalchemy.exc import SQLAlchemyError

from assistax_board.problems import Problem
from assistax_board.store import schema
from assistax_board.store.database import Database, insert_once
from assistax_board.store.schema import RATE

SHARE_SECONDS = 1.0  # between two times that counts are shared
CLOCKS_APART = 10.0  # seconds that servers may differ by


class Limiter:
    """Counts requests in sliding windows; without a database, in this process alone."""

    def __init__(self, database: Database | None = None, key: bytes = b"") -> None:
        self._counts = _Counts(database)
        self._windows, self._key = SlidingWindowCounterRateLimiter(self._counts), key

    def hit(self, rate: RateLimitItem, who: str) -> None:
        """Count a request.

        Raises:
            Problem: It is one too many.
        """
        if not self._windows.hit(rate, self._name(who)):
            wait = self._windows.get_window_stats(rate, self._name(who)).reset_time - time.time()
            message = f"more than {rate}; wait and try again"
            raise Problem("too_many_requests", message, max(1, math.ceil(wait)))

    def left(self, rate: RateLimitItem, who: str) -> int:
        """Return how many requests may still be made now."""
        return self._windows.get_window_stats(rate, self._name(who)).remaining

    def _name(self, who: str) -> str:
        return hmac.new(self._key, who.encode(), hashlib.sha256).hexdigest()[:32]


class _Running(threading.Timer):
    """Stands for the timer of `limits`, so that none is started.

    While anybody asks, that is a new thread each hundredth of a second, which looks through all
    counts; on a busy machine whoever asks waits for its start.
    """

    def is_alive(self) -> bool:
        """Say yes."""
        return True


class _Counts(MemoryStorage):
    """Counts in memory, and how the database's, which all servers add to, come into them."""

    def __init__(self, database: Database | None) -> None:
        self._database = database
        self._lock = threading.Lock()
        self._forgot_at = time.time()
        self._own: Counter[str] = Counter()  # that the database does not have yet
        self._learnt_at = 0.0
        self._thread: threading.Thread | None = None
        super().__init__()
        self.timer.join()
        self.timer = _Running(0.0, self._forget)

    def incr(self, key: str, expiry: float, amount: int = 1) -> int:
        """Count, and see to it that others learn of it."""
        with self._lock:
            if self._database is not None and self._thread is None:
                with contextlib.suppress(SQLAlchemyError), self._database.read() as connection:
                    self._learn(self._changed(connection))  # while nobody came here
                args = (self._database,)
                self._thread = threading.Thread(target=self._share_on, args=args, daemon=True)
                self._thread.start()
            self._forget()
            self._own[key] += amount
            return super().incr(key, expiry, amount)

    def decr(self, key: str, amount: int = 1) -> int:
        """Take a count back."""
        with self._lock:
            self._own[key] -= amount
            return super().decr(key, amount)

    def _forget(self) -> None:
        """Drop what has expired, once in a while; the caller has the lock."""
        now = time.time()
        if now - self._forgot_at > SHARE_SECONDS:
            self._forgot_at = now
            for key in [key for key, until in self.expirations.items() if until <= now]:
                self.clear(key)
                self.expirations.pop(key, None)

    def _share_on(self, database: Database) -> None:
        """Share what is counted, again and again until nothing is."""
        while True:
            time.sleep(SHARE_SECONDS)
            with self._lock:
                if not self._own:
                    self._thread = None
                    return
                shared, self._own = self._own, Counter()
            try:
                with database.write() as connection:
                    self._share(connection, shared)
                    rows = self._changed(connection)
                with self._lock:
                    self._learn(rows)
            except SQLAlchemyError:  # it is away, or full
                with self._lock:
                    self._own.update(shared)

    def _share(self, connection: sa.Connection, counts: Counter[str]) -> None:
        now = time.time()
        connection.execute(sa.delete(schema.rates).where(RATE.expires_at < now))
        for key, count in sorted(counts.items()):  # in one order: writers must not lock each other
            expires = self.expirations.get(key, now)
            row = {"name": key, "count": count, "changed_at": now, "expires_at": expires}
            if not insert_once(connection, schema.rates, row):
                more = sa.update(schema.rates).where(RATE.name == key)
                connection.execute(more.values(count=RATE.count + count, changed_at=now))

    def _changed(self, connection: sa.Connection) -> list[Any]:
        since, self._learnt_at = self._learnt_at - CLOCKS_APART, time.time()
        return list(connection.execute(sa.select(schema.rates).where(RATE.changed_at > since)))

    def _learn(self, rows: list[Any]) -> None:
        """Take over the counts that have changed; the caller has the lock."""
        for row in rows:
            self.storage[row.name] = row.count + self._own[row.name]
            self.expirations[row.name] = row.expires_at
