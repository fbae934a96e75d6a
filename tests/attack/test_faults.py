"""Faults of the machine: no room, no right to write, no descriptors, little memory."""

import contextlib
import subprocess
from collections.abc import Generator
from pathlib import Path

import pytest

from tests.attack.commands import Command
from tests.attack.ledger import attack
from tests.attack.process import Attack, Outcome, call

FAULTS: dict[str, Attack] = {
    **{f"files of {size} bytes": Attack(limits={"RLIMIT_FSIZE": size}) for size in (0, 300, 4000)},
    **{f"{count} descriptors": Attack(limits={"RLIMIT_NOFILE": count}) for count in (8, 12, 20)},
    **{f"{size} MiB": Attack(limits={"RLIMIT_AS": size << 20}) for size in (1, 600, 1200)},
    "no standard input": Attack(closed=(0,)),
    "no standard output": Attack(closed=(1,)),
}
DISKS = {"a full disk": "size=64k", "a disk of 200 kB": "size=200k", "read-only": "ro"}
CHEAP = ("publish", "fetch", "report")  # without JAX, whose C++ ends where memory does


def ended_well(outcome: Outcome) -> None:
    told = outcome.err[-400:]
    assert outcome.code in (0, 1), f"{outcome.code}: {told}"
    assert "Traceback" not in outcome.err, told
    assert outcome.code == 0 or not outcome.err or "error: " in outcome.err, told
    assert not outcome.outside, outcome.outside


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


def leaves_no_wrong_file(command: Command, home: Path, wanted: dict[str, str]) -> None:
    left = command.figures(home)
    assert left.items() <= wanted.items(), "a file is not of an undisturbed run"


@pytest.mark.attack
@pytest.mark.parametrize("name", CHEAP)
def test_limits(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    call(command.words, tmp_path / "whole")
    wanted = dict(command.figures(tmp_path / "whole"))
    with attack(f"faults of {name}") as ledger:
        cases = list(FAULTS)
        ledger.random.shuffle(cases)
        for number, fault in enumerate(cases[: max(4, ledger.wanted(len(cases)))]):
            home = tmp_path / str(number)
            with ledger.trial(f"{name}, {fault}"):
                ended_well(call(command.words, home, FAULTS[fault]))
                leaves_no_wrong_file(command, home, wanted)
                assert call(command.words, home).code == 0
                assert command.figures(home) == wanted


@pytest.mark.attack
@pytest.mark.parametrize("name", [*CHEAP, "evaluate"])
def test_disks(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    call(command.words, tmp_path / "whole")
    wanted = dict(command.figures(tmp_path / "whole"))
    target = {"publish": "mine", "fetch": "cache", "report": ".", "evaluate": "out"}[name]
    with attack(f"disks of {name}") as ledger:
        for number, (fault, options) in enumerate(DISKS.items()):
            home = tmp_path / str(number)
            if target == ".":
                command_words = [*command.words[:-1], "small/page.html"]
            else:
                command_words = list(command.words)
            small = home / ("small" if target == "." else target)
            with mounted(small, options) as there, ledger.trial(f"{name}, {fault}"):
                if not there:
                    continue
                ended_well(call(command_words, home))
                leaves_no_wrong_file(command, home, wanted)
