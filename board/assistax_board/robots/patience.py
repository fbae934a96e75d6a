"""A time limit for work at home that may be deep inside a compiler."""

import contextlib
import os
import sys
import threading
import time
from collections.abc import Callable, Generator

SAY_SECONDS = 15.0  # between two lines of a block that still runs


@contextlib.contextmanager
def time_limit(
    seconds: float, advice: str, end: Callable[[], object] = lambda: os._exit(1)
) -> Generator[Callable[[str], None]]:
    """Report a block's progress now and then, and end this process if it takes too long.

    Nothing else stops a compiler. Lines go to standard error.

    Args:
        seconds: By the clock, that the block may take.
        advice: What to do about it, for the error's end.
        end: Ends the process.

    Yields:
        A function that takes what the block does next, in words.

    Raises:
        ValueError: `seconds` is not positive.
    """
    if not seconds > 0:
        raise ValueError(f"the time limit is {seconds} s; allowed is a positive number of seconds")
    over, began, doing = threading.Event(), time.monotonic(), ["working"]

    def say(what: str) -> None:
        doing[0] = what
        print(f"{what} ...", file=sys.stderr, flush=True)

    def watch() -> None:
        while (left := began + seconds - time.monotonic()) > 0:
            if over.wait(min(SAY_SECONDS, left)):
                return
            took = f"{time.monotonic() - began:.0f} of at most {seconds:g} s"
            print(f"still {doing[0]}: {took}", file=sys.stderr, flush=True)
        message = f"{doing[0]} took more than the time limit of {seconds:g} s; {advice}"
        print(f"error: {message}", file=sys.stderr, flush=True)
        end()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield say
    finally:
        over.set()
        watcher.join()
