"""Counts of attacks: how many trials a family made, and which of them failed.

A whole attack is minutes long, so by default a tenth of it runs; `make attack` asks for all. Trials
are seeded: the same share of the same seed is the same attack again.
"""

import contextlib
import json
import os
import random
import time
from collections.abc import Generator
from pathlib import Path

from tests.attack.process import Outcome

SHARE = float(os.environ.get("ASSISTAX_ATTACK", "0.1"))  # of the trials
SEED = os.environ.get("ASSISTAX_ATTACK_SEED", "0")
LOG = os.environ.get("ASSISTAX_ATTACK_LOG")  # a file to which every family adds its counts
SECONDS, MEMORY = 30.0, 1 << 30  # that a trial may take


class Ledger:
    """The trials of one family; a failed one does not stop those after it."""

    def __init__(self, family: str, seconds: float = SECONDS) -> None:
        self.family, self.trials, self.seconds = family, 0, seconds
        self.slowest = self.largest = 0.0  # seconds without waiting for a processor; MiB
        self.struck = 0  # trials whose kill or interrupt came before the command's end
        self.failures: list[str] = []
        self._excused = 0.0  # seconds of a trial that were judged command by command
        self._began, self._computed = time.process_time(), 0.0
        self.random = random.Random(f"{family} {SEED}")

    def wanted(self, whole: int) -> int:
        """Return how many trials to make of the `whole` attack, at least one."""
        return max(1, round(whole * SHARE))

    @contextlib.contextmanager
    def trial(self, name: str) -> Generator[None]:
        """Count what happens within as one trial, and an error of any kind as its failure."""
        self.trials += 1
        began, before, waited = time.monotonic(), _peak_memory(), _waited()
        try:
            yield
            self._bounded(
                time.monotonic() - began - (_waited() - waited) - self._excused,
                _peak_memory() - before,
            )
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a panic of a Rust library is no Exception
            self.failures.append(f"{name}: {type(error).__name__}: {str(error)[:500]}")
        self._excused = 0.0

    @contextlib.contextmanager
    def excused(self) -> Generator[None]:
        """Leave the time of what happens within out of a trial's: nobody waits for it."""
        began, waited = time.monotonic(), _waited()
        yield
        self._excused += time.monotonic() - began - (_waited() - waited)

    def judge(self, outcome: Outcome) -> None:
        """Hold a command's end against what holds for every command, however it was struck."""
        self._excused += outcome.seconds
        self._computed += outcome.computed
        assert "Traceback" not in outcome.err, outcome.err[-400:]
        assert "this is unexpected" not in outcome.err, outcome.err[-400:]
        assert not outcome.outside, f"written outside: {outcome.outside}"
        self._bounded(outcome.work, outcome.peak)

    def _bounded(self, seconds: float, memory: int) -> None:
        self.slowest = max(self.slowest, seconds)
        self.largest = max(self.largest, memory / (1 << 20))
        assert seconds < self.seconds, f"took {seconds:.0f} s"
        assert memory < MEMORY, f"took {memory >> 20} MiB"

    def close(self) -> None:
        """Print the counts, and fail if a trial did."""
        line = {
            "family": self.family,
            "trials": self.trials,
            "share": SHARE,
            "failures": len(self.failures),
            **({"struck": self.struck} if self.struck else {}),
            "slowest_seconds": round(self.slowest, 1),
            "most_memory_mib": round(self.largest),
            "processor_seconds": round(time.process_time() - self._began + self._computed),
        }
        print(json.dumps(line), *self.failures, sep="\n")
        if LOG:
            with Path(LOG).open("a") as file:
                file.write(json.dumps({**line, "told": self.failures}) + "\n")
        assert not self.failures, self.failures[:5]


@contextlib.contextmanager
def attack(family: str, seconds: float = SECONDS) -> Generator[Ledger]:
    """Lend a ledger, and close it; a trial may take so many seconds."""
    ledger = Ledger(family, seconds)
    yield ledger
    ledger.close()


def _peak_memory() -> int:
    """Return the most memory that this process has taken, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0


def _waited() -> float:
    """Return how many seconds this thread was ready to run, and waited for a processor."""
    return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) / 1e9
