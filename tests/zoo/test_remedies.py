"""Libraries advise in words; the command line adds its option."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import assistax_base.errors
from assistax_base.errors import ExportError, UpdateError, ZooError
from assistax_zoo.shell.main import REMEDIES, in_options

ROOT = Path(__file__).parents[2]
ROOMS = ("assistax_base", "zoo", "workshop/assistax_workshop/press")
OPTION = re.compile(r"(?<![\w|-])--[a-z]")


def options_in_raises(source: str) -> Iterator[str]:
    """Yield texts of code that name an option, docstrings apart."""
    tree = ast.parse(source)
    statements = [node for node in ast.walk(tree) if isinstance(node, ast.Expr)]
    documented = {id(node.value) for node in statements}
    for node in ast.walk(tree):
        text = node.value if isinstance(node, ast.Constant) else None
        if isinstance(text, str) and id(node) not in documented and OPTION.search(text):
            yield text


@pytest.mark.parametrize("room", ROOMS)
def test_no_text_of_a_library_names_an_option(room: str) -> None:
    files = [path for path in (ROOT / room).rglob("*.py") if path.name != "parquet.py"]
    assert len(files) > 5
    assert [text for path in files for text in options_in_raises(path.read_text())] == []


def test_a_planted_option_is_found() -> None:
    planted = 'def f():\n    """Like --out."""\n    raise ValueError("choose another --out")\n'
    assert list(options_in_raises(planted)) == ["choose another --out"]


def test_the_shell_adds_its_option_to_what_an_error_advises() -> None:
    error = ExportError("x.onnx", "no file, or the same policy", "other content")
    assert "--" not in str(error) and in_options(error) == f" ({REMEDIES['replace the file']})"
    assert in_options(UpdateError("zoo", "the old one", "changes", "ask its owner")) == ""
    assert in_options(ValueError("steps is 0")) == ""


def test_every_remedy_has_its_words() -> None:
    keys = {"fetch before", "name a remote"}  # of single errors of `zoo.transport.fetch`
    classes = [value for value in vars(assistax_base.errors).values() if isinstance(value, type)]
    keys |= {error.remedy for error in classes if issubclass(error, ZooError) and error.remedy}
    assert keys == set(REMEDIES)
