"""The questions for new readers have answers in the code, and docstrings are drawn by a seed."""

from pathlib import Path

from tools.questions import DRAWN, draw_docstrings, lost_answers, main, read_questions


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
