"""SIGKILL at writes and at random moments: nothing half-made is taken for whole, nothing is lost.

After each kill, every file that looks finished is the one of an undisturbed run; then the same
command again ends with all of them.
"""

import signal
from pathlib import Path

import pytest

from tests.attack.commands import Command, Figures
from tests.attack.ledger import Ledger, attack
from tests.attack.process import Attack, Outcome, call

KILLS = {  # of the whole attack: 300
    "evaluate": 60,
    "crossplay": 50,
    "train": 40,
    "publish": 50,
    "fetch": 50,
    "report": 40,
    "render": 10,
}


def strike(ledger: Ledger, command: Command, home: Path, whole: Outcome, trial: int) -> Outcome:
    """Kill at a write in two of three trials, else somewhere in its computing."""
    if trial % 3 < 2:
        at = ledger.random.randint(1, max(whole.writes, 1))
        return call(command.words, home, Attack(kill_at=at))
    moment = ledger.random.uniform(0.0, 0.95) * whole.computed
    return call(command.words, home, press=(signal.SIGKILL, moment))


def check(ledger: Ledger, command: Command, home: Path, expected: Figures) -> None:
    left = command.figures(home)
    wrong = [name for name, digest in left.items() if expected.get(name) != digest]
    assert not wrong, f"after the strike {wrong} are not those of an undisturbed run"
    again = call(command.words, home)
    ledger.judge(again)
    assert again.code == 0, f"the next run ended with {again.code}: {again.err[-300:]}"
    assert command.figures(home) == expected, "the next run's figures are others"


def undisturbed(command: Command, folder: Path) -> tuple[Outcome, Figures]:
    """Run a command twice, so that no strike falls into a compilation; return the second end."""
    call(command.words, folder / "warm")
    whole = call(command.words, folder / "whole")
    expected = command.figures(folder / "whole")
    assert whole.code == 0 and expected and not whole.outside, (whole, expected)
    return whole, expected


@pytest.mark.attack
@pytest.mark.parametrize("name", KILLS)
def test_killed_commands_go_on(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    whole, expected = undisturbed(command, tmp_path)
    with attack(f"kills of {name}") as ledger:
        for trial in range(ledger.wanted(KILLS[name])):
            home = tmp_path / str(trial)
            with ledger.trial(f"{name} {trial}"):
                killed = strike(ledger, command, home, whole, trial)
                ledger.judge(killed)
                ledger.struck += killed.code == -signal.SIGKILL
                assert killed.code in (-signal.SIGKILL, 0), killed.err[-300:]
                check(ledger, command, home, expected)
