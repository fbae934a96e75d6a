"""A test that uses a private name of the code says why, in a comment at the name's first use."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
# Public in spite of their underscore: named tuples' methods, and the standard library's.
PUBLIC = {"_replace", "_asdict", "_fields", "_make", "_exit", "_thread"}
PATCHES = {"setattr", "delattr", "getattr", "hasattr"}


def test_private_names_are_used_with_a_reason() -> None:
    files = sorted(TESTS.rglob("*.py"))
    assert len(files) > 100
    unexplained = {str(file.relative_to(TESTS)): unexplained_names(file) for file in files}
    assert {file: names for file, names in unexplained.items() if names} == {}


@pytest.mark.parametrize(
    "use",
    [
        "env._physics.forward(state)",
        "from zoo.storage import _row",
        "import zoo._rows",
        'monkeypatch.setattr(storage, "_row", None)',
        'monkeypatch.setattr("zoo._rows.read", None)',
        "def test():\n    storage._row = 1",
    ],
)
def test_a_planted_use_is_found(tmp_path: Path, use: str) -> None:
    planted = tmp_path / "planted.py"
    planted.write_text(f"x = 1\n{use}\n")
    assert len(unexplained_names(planted)) == 1
    planted.write_text(f"x = 1\n{use}  # no public name says it\n")
    assert unexplained_names(planted) == []
    planted.write_text(f"x = 1\n# No public name says it.\n{use.splitlines()[-1].strip()}\n")
    assert unexplained_names(planted) == []


@pytest.mark.parametrize(
    "use", ["self._rows", "super()._learn()", "point._replace(x=1)", "a.__b__"]
)
def test_own_and_public_names_need_no_reason(tmp_path: Path, use: str) -> None:
    (tmp_path / "planted.py").write_text(use)
    assert unexplained_names(tmp_path / "planted.py") == []


def unexplained_names(file: Path) -> list[str]:
    """The private names whose first use in the file has no comment on it or right above it.

    A comment above speaks for the uses on the lines that follow one another below it.
    """
    source = file.read_text()
    lines, seen, unexplained, explained = source.splitlines(), set(), [], set()
    for first, last, name in sorted(private_uses(ast.parse(source))):
        above = lines[first - 2].strip() if first > 1 else ""
        if above.startswith("#") or explained & {first - 1, first}:
            explained |= {*range(first, last + 1)}
        elif name not in seen and not any("#" in line for line in lines[first - 1 : last]):
            unexplained.append(f"{first}: {name}")
        seen.add(name)
    return unexplained


def private_uses(tree: ast.Module) -> Iterator[tuple[int, int, str]]:
    """First line, last line and name of each use; the lines are those of the whole statement."""
    for statement in ast.walk(tree):
        if not isinstance(statement, ast.stmt):
            continue
        body = getattr(statement, "body", None)
        last = body[0].lineno - 1 if body else statement.end_lineno or statement.lineno
        for node in own_nodes(statement):
            for name in names_of(node):
                if is_private(name):
                    yield statement.lineno, max(last, statement.lineno), name


def own_nodes(statement: ast.AST) -> Iterator[ast.AST]:
    """The statement's nodes without the statements inside it."""
    yield statement
    for child in ast.iter_child_nodes(statement):
        if not isinstance(child, ast.stmt):
            yield from own_nodes(child)


def names_of(node: ast.AST) -> list[str]:
    """The names that a node takes from other objects and modules."""
    match node:
        case ast.Attribute(value=ast.Name(id="self" | "cls")):
            return []
        case ast.Attribute(value=ast.Call(func=ast.Name(id="super"))):
            return []
        case ast.Attribute(attr=name):
            return [name]
        case ast.Import(names=names):
            return [part for alias in names for part in alias.name.split(".")]
        case ast.ImportFrom(module=module, names=names):
            return [*(module or "").split("."), *(alias.name for alias in names)]
        case ast.Call(func=ast.Attribute(attr=call) | ast.Name(id=call), args=args) if (
            call in PATCHES
        ):
            texts = [arg.value for arg in args[:2] if isinstance(arg, ast.Constant)]
            return [part for text in texts if isinstance(text, str) for part in text.split(".")]
    return []


def is_private(name: str) -> bool:
    return bool(re.fullmatch(r"_[A-Za-z0-9]\w*", name)) and name[-1] != "_" and name not in PUBLIC
