"""SIGINT at random moments: one line, exit code 130, soon; and what is finished is kept."""

import signal
from pathlib import Path

import pytest

from tests.attack.commands import Command
from tests.attack.ledger import attack
from tests.attack.process import Outcome, call

INTERRUPTS = {  # of the whole attack: 60
    "evaluate": 14,
    "crossplay": 12,
    "train": 10,
    "publish": 8,
    "fetch": 8,
    "report": 6,
    "render": 2,
}
SOON = 4.0  # seconds; 2 on a machine that does nothing else


def ended_well(outcome: Outcome) -> None:
    told = outcome.err[-300:]
    assert outcome.code in (0, 130), told  # 0: it was done before the key press
    assert "Traceback" not in outcome.err and outcome.err.count("error") <= 1, told
    if outcome.code == 130:
        assert outcome.err.splitlines()[-1] == "error: interrupted", told
        assert outcome.seconds < SOON, f"{outcome.seconds:.1f} s after the key press"


@pytest.mark.attack
@pytest.mark.parametrize("name", INTERRUPTS)
def test_interrupted_commands(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    call(command.words, tmp_path / "warm")
    whole = call(command.words, tmp_path / "whole")
    wanted = command.figures(tmp_path / "whole")
    assert whole.code == 0 and wanted, whole.err
    with attack(f"interrupts of {name}") as ledger:
        for trial in range(ledger.wanted(INTERRUPTS[name])):
            home = tmp_path / str(trial)
            with ledger.trial(f"{name} {trial}"):
                seconds = ledger.random.uniform(0.0, 1.0) * whole.seconds
                ended_well(call(command.words, home, press=(signal.SIGINT, seconds)))
                left = command.figures(home)
                assert left.items() <= wanted.items(), "a file is not of an undisturbed run"
                again = call(command.words, home)
                assert again.code == 0, again.err[-300:]
                assert command.figures(home) == wanted
