"""Runs a function in a process of its own, limited in seconds and bytes, on untrusted files.

The process is forked from one that has imported what is heavy (a fork server), so it begins at
once, and its memory is given back when it ends. Its answer is JSON: nothing that it says is
executed. `RLIMIT_AS` does not suit JAX, which reserves far more than it uses; memory is watched
from outside, and `RLIMIT_DATA` catches what grows between two looks.
"""

import contextlib
import json
import multiprocessing
import resource
import signal
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

LOOK_SECONDS = 0.02  # between two looks at its memory
STALL = 10.0  # times its seconds, it may take by the clock on a busy machine
_ANSWER_BYTES = 64 * 1024
_SLACK = 4  # times its bytes, it may reserve
_FILE_BYTES = 64 * 1024 * 1024
_HEAVY = (
    "assistax_board.robots.behind",  # first: what the others cost comes after requests
    "assistax_board.robots.admission",
    "jax",
    "onnx",
    "population.networks.policy",
    "zoo.parameters.storage",
)


class OverBudgetError(Exception):
    """A function exceeded its budget of `what`: "seconds" or "bytes"."""

    def __init__(self, what: str) -> None:
        super().__init__(f"it took too many {what}")
        self.what = what


class DiedError(Exception):
    """The process ended without an answer, by its own doing."""


class BusyError(Exception):
    """The machine gave the process no time to answer, or ended it from outside."""


_stopping = threading.Event()
_running: set[Any] = set()
_FROM_OUTSIDE = (-signal.SIGTERM, -signal.SIGKILL, -signal.SIGINT)


def run_limited(function: Callable[..., Any], *args: Any, seconds: int, most_bytes: int) -> Any:
    """Run a module's function in a process of its own and return its result.

    Args:
        function: Of a module; its answer is JSON.
        args: To be pickled.
        seconds: Of processors.
        most_bytes: Of memory.

    Raises:
        OverBudgetError: It took more.
        DiedError: The process died.
        BusyError: It had no time to use its seconds in, or this process is about to end.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(list(_HEAVY))
    here, there = context.Pipe()
    limits = seconds, most_bytes
    process = context.Process(target=_answer, args=(there, function, *limits), daemon=True)
    process.start()
    there.close()
    _running.add(process)
    try:
        if _stopping.is_set():
            raise BusyError
        with contextlib.suppress(BrokenPipeError):
            here.send(args)
        return json.loads(_wait(here, process, seconds, most_bytes))
    except (EOFError, ConnectionError):
        process.join()
        if process.exitcode == -signal.SIGXCPU:
            raise OverBudgetError("seconds") from None
        raise (BusyError if process.exitcode in _FROM_OUTSIDE else DiedError) from None
    finally:
        _running.discard(process)
        process.kill()
        process.join()
        here.close()


def stop_limited() -> None:
    """End all running processes and start no more, since this process is about to end."""
    _stopping.set()
    for process in list(_running):
        process.kill()


def resident_bytes(pid: int) -> int:
    """Return a process's resident memory in bytes, 0 if the system does not report it."""
    with contextlib.suppress(OSError), open(f"/proc/{pid}/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()
    return 0


def _wait(here: Connection, process: Any, seconds: int, most_bytes: int) -> bytes:
    end = time.monotonic() + STALL * seconds
    while not here.poll(LOOK_SECONDS):
        if resident_bytes(process.pid) > most_bytes:
            raise OverBudgetError("bytes")
        if time.monotonic() > end:
            raise BusyError
    return here.recv_bytes(_ANSWER_BYTES)


def _answer(there: Connection, function: Callable[..., Any], seconds: int, most: int) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_DATA, (_SLACK * most, _SLACK * most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, _FILE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is about the server
    there.send_bytes(json.dumps(function(*there.recv())).encode())
