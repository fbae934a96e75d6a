"""Counts of requests: none starts a thread, and those that have expired are forgotten."""

import threading

import pytest
from limits import parse

from assistax_board.api import rates
from assistax_board.api.rates import Limiter


def test_counts_are_forgotten_without_a_thread_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """`limits` starts one each hundredth of a second, for which a busy server waits."""
    monkeypatch.setattr(rates, "FORGET_SECONDS", 0.0)
    now = 1_000_000.0
    monkeypatch.setattr("time.time", lambda: now)
    limiter = Limiter()
    monkeypatch.setattr(threading.Thread, "start", lambda self: pytest.fail("a thread"))
    for reader in range(100):
        limiter.hit(parse("3/minute"), f"reader {reader}")
    counts = limiter._counts  # what it keeps has no public name
    assert len(counts.storage) >= 100
    now += 1000.0
    limiter.hit(parse("3/minute"), "a reader")
    assert len(counts.storage) <= 2 and len(counts.expirations) <= 2
