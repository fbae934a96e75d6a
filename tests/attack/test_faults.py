"""Faults of the machine: no room, no right to write, no descriptors, little memory."""

import contextlib
import signal
import subprocess
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.attack.commands import Command
from tests.attack.ledger import Ledger, attack
from tests.attack.process import Attack, Outcome, call

MIB = 1 << 20
FAULTS: dict[str, Attack] = {
    **{f"files of {size} bytes": Attack(limits={"RLIMIT_FSIZE": size}) for size in (0, 300, 4000)},
    **{f"{count} more descriptors": Attack(more_files=count) for count in (0, 1, 2, 5, 12)},
    **{f"{count} more threads": Attack(more_threads=count) for count in (0, 1, 3)},
    **{f"{size} MiB": Attack(limits={"RLIMIT_AS": size * MIB}) for size in (1, 600, 1200)},
    "no standard input": Attack(closed=(0,)),
    "no standard output": Attack(closed=(1,)),
}
DISKS = {"a full disk": "size=64k", "a disk of 200 kB": "size=200k", "read-only": "ro"}
CHEAP = ("publish", "fetch", "report")


def ended_well(ledger: Ledger, outcome: Outcome, fault: Attack) -> None:
    ledger.judge(outcome)
    message = outcome.err[-400:]
    # Where memory ends within a C++ library, it aborts, and no handler of ours is asked.
    if outcome.code == -signal.SIGABRT and "RLIMIT_AS" in fault.limits:
        return
    assert outcome.code in (0, 1), f"{outcome.code}: {message}"
    assert outcome.code == 0 or not outcome.err or "error: " in outcome.err, message


@contextlib.contextmanager
def mounted(folder: Path, options: str) -> Generator[bool]:
    """Mount a small file system in memory; say whether that is allowed here."""
    folder.mkdir(parents=True)
    done = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], capture_output=True
    )
    try:
        yield done.returncode == 0
    finally:
        if done.returncode == 0:
            subprocess.run(["umount", "--lazy", str(folder)], check=True)


def leaves_no_wrong_file(command: Command, home: Path, expected: dict[str, str]) -> None:
    left = command.figures(home)
    assert left.items() <= expected.items(), "a file is not of an undisturbed run"


@pytest.mark.attack
@pytest.mark.parametrize("name", CHEAP)
def test_limits(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    call(command.words, tmp_path / "whole")
    expected = dict(command.figures(tmp_path / "whole"))
    with attack(f"faults of {name}") as ledger:
        cases = list(FAULTS)
        ledger.random.shuffle(cases)
        for number, fault in enumerate(cases[: ledger.wanted(len(cases))]):
            home = tmp_path / str(number)
            with ledger.trial(f"{name}, {fault}"):
                ended_well(ledger, call(command.words, home, FAULTS[fault]), FAULTS[fault])
                leaves_no_wrong_file(command, home, expected)
                again = call(command.words, home)
                assert again.code == 0 and command.figures(home) == expected, again.err[-300:]


PLACES = {"publish": "mine", "fetch": "cache", "report": "small", "evaluate": "out"}


@pytest.mark.attack
@pytest.mark.parametrize("name", PLACES)
def test_disks(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    words = [*command.words[:-1], "small/page.html"] if name == "report" else command.words
    call(command.words, tmp_path / "whole")
    expected = dict(command.figures(tmp_path / "whole"))
    with attack(f"disks of {name}") as ledger:
        cases = list(DISKS.items())
        ledger.random.shuffle(cases)
        for number, (fault, options) in enumerate(cases[: ledger.wanted(len(cases))]):
            home = tmp_path / str(number)
            with mounted(home / PLACES[name], options) as there, ledger.trial(f"{name}, {fault}"):
                if not there:
                    pytest.skip("may not mount a file system")
                ended_well(ledger, call(words, home), Attack())
                leaves_no_wrong_file(command, home, expected)
