"""Errors of the libraries speak to users of Python too: they name no option of the command line."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.house import raised_options

ROOT = Path(__file__).parents[2]
ROOMS = ("record", "figures", "replay", "plots", "report")


def options_named(source: str) -> Iterator[str]:
    """Yield the options in texts of raises."""
    yield from (option for _, option in raised_options(ast.parse(source)))


@pytest.mark.parametrize("room", ROOMS)
def test_no_error_names_an_option(room: str) -> None:
    for path in sorted((ROOT / "evaluation" / room).rglob("*.py")):
        assert not list(options_named(path.read_text(encoding="utf-8"))), path


def test_an_option_in_a_raise_is_seen() -> None:
    planted = 'raise ValueError(f"{sample} is no sample; give at least 1 (--sample " "20)")'
    assert list(options_named(planted)) == ["--sample"]
