"""Runs `assistax-zoo serve` in this process and signals it at chosen moments of its start.

A moment is a number of Python calls of the main thread, counted from the start or from a function,
so that it is the same on any machine. Words: MOMENTS as JSON, a file for the count, the command's.
"""

import json
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

FIRST = ""  # counted from the start


class Fate:
    """Sends signals; each moment is [function, calls since it was called, signal]."""

    def __init__(self, moments: list[tuple[str, int, int]], written: Path) -> None:
        self._written = written
        self._moments: list[Any] = [list(moment) for moment in moments]
        self.calls = 0

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        if event != "call":
            return
        self.calls += 1
        name = frame.f_code.co_qualname
        for moment in self._moments:
            if moment[0] == name:
                moment[:2] = FIRST, self.calls + moment[1]
            if moment[0] == FIRST and self.calls >= moment[1]:
                self._moments.remove(moment)
                self._written.write_text(json.dumps(self.calls))
                os.kill(os.getpid(), moment[2])
                break


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # the shell may ignore it
    written, moments = Path(sys.argv[2]), json.loads(sys.argv[1])
    sys.argv = ["assistax-zoo", *sys.argv[3:]]
    sys.setprofile(Fate(moments, written))
    from assistax_zoo.__main__ import start

    sys.exit(start())
