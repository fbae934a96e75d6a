"""Errors of the libraries speak to users of Python too: they name no option of the command line."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("record", "figures", "replay", "plots", "report")


def options_named(source: str) -> Iterator[str]:
    """Yield the options in texts of raises."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Raise):
            for part in ast.walk(node):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    yield from re.findall(r"--[a-z][a-z-]+", part.value)


@pytest.mark.parametrize("room", ROOMS)
def test_no_error_names_an_option(room: str) -> None:
    for path in sorted((ROOT / "evaluation" / room).rglob("*.py")):
        assert not list(options_named(path.read_text(encoding="utf-8"))), path


def test_an_option_in_a_raise_is_seen() -> None:
    planted = 'raise ValueError(f"{sample} is no sample; give at least 1 (--sample " "20)")'
    assert list(options_named(planted)) == ["--sample"]
