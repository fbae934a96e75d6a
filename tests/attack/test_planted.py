"""Each planted defect is caught by the test that guards against it."""

from pathlib import Path

import pytest

from tests.attack.ledger import attack
from tests.attack.planted import DEFECTS, copy_project, plant, run_test

FAILED, FINISHED = 1, 0  # pytest's exit codes; others are errors of its own


@pytest.mark.attack
@pytest.mark.slow
def test_planted_defects_are_caught(tmp_path: Path) -> None:
    copy = copy_project(tmp_path / "copy")
    with attack("planted defects") as ledger:
        cases = list(DEFECTS.items())
        ledger.random.shuffle(cases)
        for name, defect in cases[: ledger.wanted(len(cases))]:
            with ledger.trial(name):
                text = plant(defect, copy)
                code, told = run_test(defect.test, copy)
                (copy / defect.file).write_text(text, encoding="utf-8")
                assert code == FAILED, f"{defect.test} ended with {code}: {told[-300:]}"
                sound, told = run_test(defect.test, copy)
                assert sound == FINISHED, f"without the defect it ended with {sound}: {told[-300:]}"
