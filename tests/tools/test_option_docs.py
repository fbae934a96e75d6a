"""Options of commands and arguments of Python functions have one documentation."""

import inspect
from pathlib import Path

import pytest

import assistax_zoo as az
from tools import option_docs

TASK_TEXT = "Task, such as scratch. Default: that of the names."
OPTIONS = {
    "evaluate": (
        *("task", "episodes", "seed", "backend", "stochastic", "max_envs", "preferences"),
        *("series", "split", "partners", "persons", "include_own", "trained_with"),
        *("references", "crossplay", "fetch", "reuse", "replace"),
    ),
    "cross_play": (
        *("task", "episodes", "seed", "backend", "stochastic", "max_envs", "preferences"),
        *("persons", "release", "replace"),
    ),
}


@pytest.mark.parametrize("function", OPTIONS)
def test_python_documents_an_option_as_its_command(function: str) -> None:
    text = option_docs.FUNCTIONS.read_text(encoding="utf-8")
    written = option_docs.documented(text, function)
    assert set(written) == set(inspect.signature(getattr(az, function)).parameters)
    sources: dict[str, str] = {}
    for path, name in option_docs.SOURCES[function]:
        sources |= option_docs.documented((option_docs.ROOT / path).read_text("utf-8"), name)
    for option in OPTIONS[function]:
        assert written[option] == sources[option], "run python -m tools.option_docs"


def test_docstrings_of_the_functions_are_up_to_date() -> None:
    text = option_docs.FUNCTIONS.read_text(encoding="utf-8")
    assert option_docs.updated(text) == text, "run python -m tools.option_docs"


def test_changed_option_changes_the_functions(tmp_path: Path) -> None:
    for path in {path for sources in option_docs.SOURCES.values() for path, _ in sources}:
        text = (option_docs.ROOT / path).read_text(encoding="utf-8")
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text.replace(TASK_TEXT, "Another text."))
    text = option_docs.FUNCTIONS.read_text(encoding="utf-8")
    assert option_docs.updated(text, tmp_path).count("        task: Another text.\n") == 2
