"""SIGINT at random moments: one line, exit code 130, soon; and what is finished is kept."""

import signal
from pathlib import Path

import pytest

from tests.attack.commands import Command
from tests.attack.ledger import Ledger, attack
from tests.attack.process import Outcome, call
from tests.attack.test_kills import check, undisturbed
from tests.cli.test_interrupts import last_line

INTERRUPTS = {  # of the whole attack: 60
    "evaluate": 14,
    "crossplay": 12,
    "train": 10,
    "publish": 8,
    "fetch": 8,
    "report": 6,
    "render": 2,
}
SOON = 2.0  # seconds, without those that it waited for a processor


def ended_well(ledger: Ledger, outcome: Outcome, name: str) -> None:
    ledger.judge(outcome)
    message = outcome.err[-300:]
    assert outcome.code in (0, 130), f"{outcome.code}: {message}"  # 0: done before the key press
    assert outcome.err.count("error") <= 1, message
    if outcome.code == 130:
        spent = outcome.seconds - outcome.waited
        assert outcome.err.splitlines()[-1] == last_line(name), message
        assert spent < SOON, f"{spent:.1f} s after the key press"


@pytest.mark.attack
@pytest.mark.parametrize("name", INTERRUPTS)
def test_interrupted_commands(name: str, table: dict[str, Command], tmp_path: Path) -> None:
    command = table[name]
    whole, expected = undisturbed(command, tmp_path)
    with attack(f"interrupts of {name}") as ledger:
        for trial in range(ledger.wanted(INTERRUPTS[name])):
            home = tmp_path / str(trial)
            with ledger.trial(f"{name} {trial}"):
                moment = ledger.random.uniform(0.0, 0.95) * whole.computed
                pressed = call(command.words, home, press=(signal.SIGINT, moment))
                ended_well(ledger, pressed, name)
                ledger.struck += pressed.code == 130
                check(ledger, command, home, expected)
