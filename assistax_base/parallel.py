"""Work in daemon threads, so that interrupts and the end of a process do not wait for it."""

import contextlib
import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from assistax_base.errors import RemoteError

SLACK, SLOWEST = 60.0, 32_768  # seconds, and bytes a second, that a fetch may take at most
T = TypeVar("T")


def run_all(
    works: Sequence[Callable[[threading.Event], T]], workers: int, size: int, what: str
) -> list[T]:
    """Return the results of all works, in order. The first error stops the others by their event.

    The threads are daemons: neither an interrupt nor a server that sends a byte a second waits for
    them. All must be done within `SLACK` seconds and what `size` bytes take at `SLOWEST`.

    Raises:
        RemoteError: It takes longer than that.
    """
    stop, todo, done = threading.Event(), queue.SimpleQueue(), queue.SimpleQueue()

    def serve() -> None:
        with contextlib.suppress(queue.Empty):
            while not stop.is_set():
                index, work = todo.get_nowait()
                try:
                    done.put((index, work(stop), None))
                except BaseException as error:
                    done.put((index, None, error))

    for item in enumerate(works):
        todo.put(item)
    for _ in range(min(workers, len(works))):
        threading.Thread(target=serve, daemon=True).start()
    ends, results = time.monotonic() + SLACK + size / SLOWEST, {}
    try:
        while len(results) < len(works):
            index, result, error = done.get(timeout=max(0.0, ends - time.monotonic()))
            if error:
                raise error
            results[index] = result
    except queue.Empty:
        found = f"no end within {SLACK + size / SLOWEST:.0f} seconds"
        advice = "fetch again later, or from another remote"
        raise RemoteError(what, "all bytes", found, advice) from None
    finally:
        stop.set()
    return [results[index] for index in range(len(works))]
