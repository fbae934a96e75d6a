"""Ctrl-C ends a command soon, whatever runs at that moment."""

import contextlib
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Generator
from importlib.machinery import ExtensionFileLoader
from types import FrameType
from typing import NoReturn

EXIT_INTERRUPT = 130
# Commands that continue from what their --out holds.
CONTINUED = {"audit", "crossplay", "evaluate", "sweep", "train", "train-ego"}
GRACE = 1.0  # seconds for the command to stop by itself; a compilation may take ten times that

# What calls a module of C or C++ as it is loaded.
LOADING = ExtensionFileLoader.create_module.__code__, ExtensionFileLoader.exec_module.__code__

_interrupted = threading.Event()
_ending = threading.RLock()
_said = threading.Event()


def interrupted() -> bool:
    """Return whether Ctrl-C was pressed; XLA may have made another error of the interrupt."""
    return _interrupted.is_set()


@contextlib.contextmanager
def ended_by_interrupts() -> Generator[None]:
    """End this process at Ctrl-C, within a little more than `GRACE` seconds.

    The main thread gets its KeyboardInterrupt as always, but not before XLA's or MuJoCo's C++ code
    returns. So a thread is told of the signal too, through a pipe that C code writes to. What is
    finished is kept: every file is written beside its place, then renamed. This holds to the end:
    also for an interrupt that was lost, and while the interpreter shuts down.

    Raises:
        OSError: This process may open no more files.
        RuntimeError: It may start no more threads.
    """
    numbers, tell = os.pipe()
    os.set_blocking(tell, False)
    threading.Thread(target=_watch, args=(numbers,), name="interrupts", daemon=True).start()
    before = signal.set_wakeup_fd(tell, warn_on_full_buffer=False)
    remembers = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if remembers:  # not where it is ignored, as in the background
        signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = _hide_interrupts
    try:
        try:
            yield
        finally:
            if remembers:
                signal.signal(signal.SIGINT, _end)
    except KeyboardInterrupt:
        end_now()
    finally:
        if interrupted():
            end_now()
        signal.set_wakeup_fd(before)
        sys.unraisablehook = sys.__unraisablehook__
        os.close(tell)  # the thread reads the pipe's end, and is gone


def end_now() -> NoReturn:
    """End this process as interrupted, without the interpreter's shutdown.

    That would unload modules under XLA's threads, which still call into them: a crash.
    """
    _ending.acquire()  # never released: one line, whoever is first
    if not _said.is_set():  # else Ctrl-C struck again in here
        _said.set()
        continued = CONTINUED.intersection(sys.argv[1:2]) and "--out" in sys.argv
        kept = "; what is done is kept, and the same command continues" if continued else ""
        with contextlib.suppress(OSError, ValueError):
            print(f"error: interrupted{kept}", file=sys.stderr, flush=True)
    os._exit(EXIT_INTERRUPT)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Remember Ctrl-C before a handler can turn it into another error.

    A module of C++ that is being loaded, such as JAX's, lets no exception through: it aborts.
    """
    _interrupted.set()
    if any(caller.f_code in LOADING for caller, _ in traceback.walk_stack(frame)):
        end_now()
    raise KeyboardInterrupt


def _end(number: int, frame: FrameType | None) -> None:
    """End the process after its work is done."""
    end_now()


def _hide_interrupts(unraisable: "sys.UnraisableHookArgs") -> None:
    """Print nothing if Ctrl-C was lost in a destructor: `_watch` ends the process."""
    if unraisable.exc_type is not KeyboardInterrupt:
        sys.__unraisablehook__(unraisable)


def _watch(numbers: int) -> None:
    while number := os.read(numbers, 1):
        if number[0] == signal.SIGINT:
            _interrupted.set()  # the main thread may be far from handling it
            time.sleep(GRACE)
            end_now()
    os.close(numbers)
