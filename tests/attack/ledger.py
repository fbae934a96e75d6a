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

SHARE = float(os.environ.get("ASSISTAX_ATTACK", "0.1"))  # of the trials
SEED = os.environ.get("ASSISTAX_ATTACK_SEED", "0")
LOG = os.environ.get("ASSISTAX_ATTACK_LOG")  # a file to which every family adds its counts
SECONDS, MEMORY = 30.0, 1 << 30  # that a trial may take


class Ledger:
    """The trials of one family; a failed one does not stop those after it."""

    def __init__(self, family: str) -> None:
        self.family, self.trials, self.slowest = family, 0, 0.0
        self.failures: list[str] = []
        self.random = random.Random(f"{family} {SEED}")

    def wanted(self, whole: int) -> int:
        """Return how many trials to make of the `whole` attack, at least one."""
        return max(1, round(whole * SHARE))

    @contextlib.contextmanager
    def trial(self, name: str) -> Generator[None]:
        """Count what happens within as one trial, and an error of any kind as its failure."""
        self.trials += 1
        began, before = time.monotonic(), _peak_memory()
        try:
            yield
            spent, grown = time.monotonic() - began, _peak_memory() - before
            self.slowest = max(self.slowest, spent)
            assert spent < SECONDS, f"took {spent:.0f} s"
            assert grown < MEMORY, f"took {grown >> 20} MiB"
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # a panic of a Rust library is no Exception
            self.failures.append(f"{name}: {type(error).__name__}: {str(error)[:500]}")

    def close(self) -> None:
        """Print the counts, and fail if a trial did."""
        line = {
            "family": self.family,
            "trials": self.trials,
            "failures": len(self.failures),
            "slowest_seconds": round(self.slowest, 1),
        }
        print(json.dumps(line), *self.failures, sep="\n")
        if LOG:
            with Path(LOG).open("a") as file:
                file.write(json.dumps({**line, "told": self.failures}) + "\n")
        assert not self.failures, self.failures[:5]


@contextlib.contextmanager
def attack(family: str) -> Generator[Ledger]:
    """Lend a ledger, and close it."""
    ledger = Ledger(family)
    yield ledger
    ledger.close()


def _peak_memory() -> int:
    """Return the most memory that this process has taken, in bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return 0
