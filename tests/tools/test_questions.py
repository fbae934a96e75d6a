"""The questions for new readers and the tables of tests name code that exists.

Docstrings are drawn by a seed.
"""

import csv
import re
from collections.abc import Iterator
from pathlib import Path

from tools.questions import DRAWN, draw_docstrings, lost_answers, main, read_questions

ROOT = Path(__file__).parents[2]
# A file of tests, with or without a test of it; or another test of the file named before.
NAMED = re.compile(r"([\w/]*test_\w+)(?:\.py)?(?:::(test_\w+))?|::(test_\w+)")


def test_questions_have_answers_in_the_code() -> None:
    assert len(read_questions()) == 20
    assert list(lost_answers()) == []


def test_lost_answer_is_found(tmp_path: Path) -> None:
    (tmp_path / "tools").mkdir()
    (tmp_path / "here.py").write_text("class Found:\n    def method(self): ...\n")
    rows = [("here.py", "Found.method"), ("here.py", "method"), ("gone.py", "Found")]
    (tmp_path / "tools/questions.toml").write_text(
        "".join(f'[[question]]\ntext = "?"\nfile = "{f}"\nname = "{n}"\n' for f, n in rows)
    )
    lost = list(lost_answers(tmp_path))
    assert lost == ["here.py has no method: ?", "gone.py has no Found: ?"]


def test_drawn_docstrings_hide_their_functions(capsys) -> None:
    drawn = draw_docstrings(3)
    assert len(set(drawn)) == DRAWN and drawn == draw_docstrings(3) != draw_docstrings(4)
    assert main(["docstrings", "3"]) == 0
    printed = capsys.readouterr().out
    assert drawn[0][1] in printed and drawn[0][0] not in printed


def lost_tests(cells: list[str]) -> Iterator[str]:
    """Yield the files and tests that the cells of a table name, and that do not exist."""
    for cell in cells:
        files: list[Path] = []
        for named, test, another in NAMED.findall(cell):
            if named:
                files = [*ROOT.glob(f"tests/**/{named.removeprefix('tests/')}.py")]
            name = test or another
            sources = [path.read_text("utf-8") for path in files]
            if not any(not name or re.search(rf"\bdef {name}\(", text) for text in sources):
                yield f"{named}::{name}" if name else named


def test_tables_name_existing_tests() -> None:
    tables = sorted((ROOT / "docs/tables").glob("*.csv"))
    cells = [
        cell
        for path in tables
        for row in csv.reader(path.read_text("utf-8").splitlines())
        for cell in row
    ]
    assert sum(len(NAMED.findall(cell)) for cell in cells) > 150
    assert list(lost_tests(cells)) == []
    here = "tests/tools/test_questions.py::test_tables_name_existing_tests"
    assert list(lost_tests([f"{here}, ::test_gone, tests/tools/test_gone.py"])) == [
        "::test_gone",
        "tests/tools/test_gone",
    ]
