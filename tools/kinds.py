"""Find code that asks which task or which kind of partner it has.

A task and a kind of partner bring what is special about them. Other code must not ask for it, or a
new task needs changes in many files.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import PurePath

from assistax_envs.versions import TASKS

# Folders and modules that may ask: `/`-separated beginnings of places.
HOMES = ("zoo/partners/", "assistax_envs/persons/", "assistax_envs/registered.py")
# The place where views of an observation are made may name the conditions of told robots.
VIEWS = "population/views.py"
NAMES = frozenset(
    {
        "PERSONS",
        "parse_person",
        "names_persons",
        "asks_for_persons",
        "GENTLE_TASKS",
        "CARE_TASKS",
    }
)
CONDITIONS = frozenset({"told", "told-partner", "told_partner"})
VERSIONS = frozenset({"env_version", "environment_version"})
# "scratch" is an ordinary word too: there it must be all of the text, or begin an id.
_WORDS = "|".join(task for task in TASKS if "_" in task)
_PLAIN = "|".join(task for task in TASKS if "_" not in task)
TASK = re.compile(rf"(?<![\w-])(?:{_WORDS})(?!\w)|^(?:{_PLAIN})$|(?<![\w-])(?:{_PLAIN})[/:]")


def may_ask(place: str) -> bool:
    """Return whether a module may ask for kinds: it defines one, registers one or is a command.

    Args:
        place: Path of the module, from the folder of its distribution.
    """
    path = PurePath(place)
    own_task = place.startswith("assistax_envs/tasks/") and path.parts[2].removesuffix(".py")
    return own_task in TASKS or "commands" in path.parts or place.startswith(HOMES)


def questions(tree: ast.Module, place: str) -> Iterator[tuple[int, str]]:
    """Yield each line of a module that asks for a kind, with the reason, in the order of lines.

    Args:
        tree: The module.
        place: Path of the module, from the folder of its distribution.
    """
    if may_ask(place):
        return
    statements = (node.value for node in ast.walk(tree) if isinstance(node, ast.Expr))
    documentation = {id(value) for value in statements if isinstance(value, ast.Constant)}
    found = set()
    for node in ast.walk(tree):
        if id(node) not in documentation:
            found |= {(line, reason) for line, reason in _reasons(node, place)}
    yield from sorted(found)


def _reasons(node: ast.AST, place: str) -> Iterator[tuple[int, str]]:
    match node:
        case ast.Constant(value=str(text)):
            if named := TASK.search(text):
                yield node.lineno, f"names the task {named[0].rstrip('/:')}"
            if text in CONDITIONS and place != VIEWS:
                yield node.lineno, f'names the condition "{text}"'
        case ast.Call(func=ast.Name(id="hasattr"), args=[asked, *_]):
            if _last_name(asked).endswith("spec"):
                yield node.lineno, f"asks {ast.unparse(node)}"
        case ast.Compare(left=left, comparators=others):
            sides = [left, *others]
            if any(map(_is_number, sides)) and any(_is_version(side, place) for side in sides):
                yield node.lineno, f"compares a version: {ast.unparse(node)}"
        case ast.Name() | ast.Attribute() | ast.FunctionDef() | ast.alias():
            name = _last_name(node)
            told = place != VIEWS and re.fullmatch(r"_?TOLD(_\w+)?", name)
            if name.removeprefix("_") in NAMES or told:
                yield node.lineno, f"refers to {name}"


def _last_name(node: ast.AST) -> str:
    """Return the name that a node reads, defines or imports; empty for other nodes."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case ast.FunctionDef(name=name) | ast.alias(name=name):
            return name
    return ""


def _is_number(node: ast.AST) -> bool:
    """Return whether a node is an integer, or a tuple, list or set of integers."""
    match node:
        case ast.Constant(value=int() as value):
            return not isinstance(value, bool)
        case ast.Tuple(elts=elements) | ast.List(elts=elements) | ast.Set(elts=elements):
            return bool(elements) and all(map(_is_number, elements))
    return False


def _is_version(node: ast.AST, place: str) -> bool:
    """Return whether a node is the version of a task or of its environment.

    Files, locks and messages have versions of their own. So `version` alone means the environment
    only in `assistax_envs`, and as an attribute of an environment or a task.
    """
    match node:
        case ast.Subscript(slice=ast.Constant(value=str(key))):
            return key in VERSIONS
        case ast.Attribute(value=owner, attr="version"):
            inside = place.startswith("assistax_envs/")
            return inside or _last_name(owner).lstrip("_") in {"env", "environment", "task"}
        case ast.Name(id="version"):
            return place.startswith("assistax_envs/")
    return _last_name(node) in VERSIONS
