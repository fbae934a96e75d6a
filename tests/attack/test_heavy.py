"""Received folders that cost memory or time: read within bounds, or refused in a line."""

import shutil
from pathlib import Path

import pytest

from tests.attack.heavy import changes
from tests.attack.ledger import Ledger, attack
from tests.attack.process import Attack, Outcome, call

MOST = 6 << 30  # bytes of addresses: the machine is spared what a trial would take
LONGEST = 60.0  # seconds until a command that waits for ever is ended
READERS = {
    "verify": ["verify", "folder"],
    "compare": ["compare", "folder", "whole"],
    "report": ["report", "folder", "--out", "page.html"],
    "plot": ["plot", "profile", "folder", "--out", "profile.svg"],
}


def ended_well(ledger: Ledger, outcome: Outcome) -> None:
    message = outcome.err[-300:]
    assert outcome.code in (0, 1), f"{outcome.code}: {message}"
    assert len(outcome.err) < 3000, f"{len(outcome.err)} characters: {outcome.err[:200]}"
    ledger.judge(outcome)


@pytest.mark.attack
@pytest.mark.slow
def test_folders_that_cost_memory(results: Path, tmp_path: Path) -> None:
    known = changes()
    with attack("folders that cost memory") as ledger:
        cases = [(change, reader) for change in known for reader in READERS]
        ledger.random.shuffle(cases)
        # One folder after the other: some take seconds to make.
        for change, reader in sorted(cases[: ledger.wanted(len(cases))]):
            home = made(known, change, results, tmp_path)
            with ledger.trial(f"{reader}, {change}"):
                limits = {"RLIMIT_AS": MOST}
                ended_well(
                    ledger, call(READERS[reader], home, Attack(limits=limits), longest=LONGEST)
                )


def made(known: dict, change: str, results: Path, folder: Path) -> Path:
    """Return a home with the changed folder and a whole one; that of another change goes."""
    home = folder / "home"
    if not (folder / "change").is_file() or (folder / "change").read_text() != change:
        shutil.rmtree(home, ignore_errors=True)
        shutil.copytree(results / "b", home / "whole")
        known[change](Path(shutil.copytree(results / "a", home / "folder")))
        (folder / "change").write_text(change)
    return home
