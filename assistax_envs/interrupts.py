"""Ctrl-C while JAX runs: work runs in its own thread, and stops between two dispatches.

CPython raises KeyboardInterrupt in the main thread, wherever that is. Inside a callback that XLA
runs there, the exception is lost, comes back as an error of XLA's, or breaks the interpreter. So
the main thread only waits, which can be interrupted at any time, and another one runs XLA.
"""

import concurrent.futures
import contextvars
import threading
from collections.abc import Callable, Iterable
from typing import TypeVar

POLL = 0.1  # seconds

T = TypeVar("T")


class StoppedError(Exception):
    """Raised inside work that was asked to stop; `interruptible` catches it."""


def interruptible(work: Callable[[Callable[[], None]], T]) -> T:
    """Return `work(check)`; on Ctrl-C raise KeyboardInterrupt once the work has stopped.

    Args:
        work: Calls `check()` wherever it may stop; that raises `StoppedError` after Ctrl-C.

    Raises:
        KeyboardInterrupt: Ctrl-C was pressed. The interpreter and JAX are as they were.
    """
    stopped = threading.Event()

    def check() -> None:
        if stopped.is_set():
            raise StoppedError

    if threading.current_thread() is not threading.main_thread():
        return work(check)  # Ctrl-C strikes the main thread alone
    context = contextvars.copy_context()  # notebooks find by it the cell that a line belongs to
    with concurrent.futures.ThreadPoolExecutor(1, "interruptible") as pool:
        done = pool.submit(lambda: context.run(work, check))
        try:
            wait_for([done])
        except BaseException:
            stopped.set()
            raise
    return done.result()


def wait_for(works: Iterable[concurrent.futures.Future]) -> None:
    """Wait until all works are done, or raise the error of the first that fails, or Ctrl-C's.

    In short waits: the signal may reach another thread, and does not wake this one.
    """
    pending = set(works)
    while pending:
        done, pending = concurrent.futures.wait(pending, POLL, concurrent.futures.FIRST_EXCEPTION)
        for work in done:
            work.result()
