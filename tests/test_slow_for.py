"""Each word of a mark `slow_for` is in the id of a case; `tests/conftest.py` holds it to that."""

import sys
from pathlib import Path

import pytest

TEST = """import pytest

@pytest.mark.slow_for("two", "{word}")
@pytest.mark.parametrize("case", ["one", "two", "three"])
def test_it(case): ...
"""
OPTIONS = ["--collect-only", "-q", "--import-mode=importlib"]
OPTIONS += ["--override-ini=markers=slow\nslow_for"]
OPTIONS += [f"-pno:{name}" for name in ("schemathesis", "cacheprovider", "faulthandler")]


def collected(folder: Path, word: str, chosen: str, *options: str) -> int:
    """Collect a test whose slow cases are "two" and those of a word; return the exit code."""
    (folder / f"test_{word}.py").write_text(TEST.format(word=word))
    words = [*OPTIONS, f"--rootdir={folder}", *options, f"{folder}/test_{word}.py{chosen}"]
    return int(pytest.main(words, plugins=[sys.modules["tests_conftest"]]))


@pytest.mark.parametrize(
    ("chosen", "code"),
    [
        ("", pytest.ExitCode.INTERRUPTED),
        ("::test_it", pytest.ExitCode.USAGE_ERROR),
        ("::test_it[one]", pytest.ExitCode.USAGE_ERROR),
    ],
)
def test_unmatched_word_ends_the_collection(tmp_path: Path, capsys, chosen: str, code: int) -> None:
    assert collected(tmp_path, "four", chosen) == code
    assert (
        "test_four.py::test_it: slow_for has 'four', which is in no case's id; "
        "ids are one, two, three\n"
    ) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("chosen", "options", "cases"),
    [
        ("", (), ["one", "two", "three"]),
        ("", ("-m", "slow"), ["two", "three"]),
        ("", ("-k", "one"), ["one"]),
        ("::test_it[one]", (), ["one"]),
    ],
)
def test_cases_that_are_not_chosen_count(
    tmp_path: Path, capsys, chosen: str, options: tuple[str, ...], cases: list[str]
) -> None:
    assert collected(tmp_path, "three", chosen, *options) == pytest.ExitCode.OK
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "::" in line] == [
        f"test_three.py::test_it[{case}]" for case in cases
    ]
