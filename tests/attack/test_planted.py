"""Each planted defect is caught by the test that guards against it."""

import re
from pathlib import Path

import pytest

from tests.attack.ledger import attack
from tests.attack.planted import DEFECTS, ROOT, copy_project, plant, run_tests

FAILED, FINISHED = 1, 0  # pytest's exit codes; others are errors of its own


@pytest.mark.parametrize("name", DEFECTS)
def test_the_line_and_the_test_are_there(name: str) -> None:
    defect = DEFECTS[name]
    file, _, test = defect.test.partition("::")
    assert re.search(defect.line, (ROOT / defect.file).read_text(encoding="utf-8"))
    assert f"\ndef {test}(" in (ROOT / file).read_text(encoding="utf-8")


@pytest.mark.attack
@pytest.mark.slow
def test_planted_defects_are_caught(tmp_path: Path) -> None:
    copy = copy_project(tmp_path / "copy")
    with attack("planted defects") as ledger:
        cases = list(DEFECTS.items())
        ledger.random.shuffle(cases)
        cases = cases[: ledger.wanted(len(cases))]
        for name, defect in cases:
            with ledger.trial(name), ledger.excused():
                text = plant(defect, copy)
                code, output = run_tests([defect.test], copy)
                (copy / defect.file).write_text(text, encoding="utf-8")
                assert code == FAILED, f"{defect.test} ended with {code}: {output[-300:]}"
        with ledger.trial("no defect"), ledger.excused():
            code, output = run_tests({defect.test for _, defect in cases}, copy)
            assert code == FINISHED, f"without a defect they ended with {code}: {output[-300:]}"
