"""Two examinations of the code's readability, for a reader new to it.

`python -m tools.questions` prints the questions of `questions.toml` whose answers are not in the
code any more. `python -m tools.questions ask` prints the questions alone.
`python -m tools.questions docstrings SEED` prints 40 docstrings of functions, drawn by a seed and
without their code, of which a reader says what each function returns.
"""

import ast
import dataclasses
import random
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

from tools.house import ROOT, read_modules

DRAWN = 40  # docstrings of an examination


@dataclasses.dataclass(frozen=True)
class Question:
    """A question about the code, and the place of its answer.

    Attributes:
        text: The question.
        file: Path of the file from the root.
        name: A function or class in it, or "CLASS.METHOD".
    """

    text: str
    file: str
    name: str


def read_questions(root: Path = ROOT) -> list[Question]:
    """Return the questions of `tools/questions.toml`, in their order."""
    text = (root / "tools" / "questions.toml").read_text(encoding="utf-8")
    return [Question(**row) for row in tomllib.loads(text)["question"]]


def lost_answers(root: Path = ROOT) -> Iterator[str]:
    """Yield the questions whose file or function does not exist."""
    for question in read_questions(root):
        path = root / question.file
        names = set(_names(ast.parse(path.read_text(encoding="utf-8")))) if path.is_file() else ()
        if question.name not in names:
            yield f"{question.file} has no {question.name}: {question.text}"


def draw_docstrings(seed: int, root: Path = ROOT) -> list[tuple[str, str]]:
    """Return place and docstring of public functions that return a value, drawn by a seed.

    The place is "MODULE:LINE" and not the function's name, which would tell too much.
    """
    found = []
    for module in read_modules(root).values():
        for function in module.functions:
            docstring = ast.get_docstring(function)
            returns = function.returns is not None and ast.unparse(function.returns) != "None"
            if docstring and returns and not function.name.startswith("_"):
                found.append((f"{module.name}:{function.lineno}", docstring))
    return random.Random(seed).sample(found, DRAWN)


def _names(tree: ast.Module) -> Iterator[str]:
    """Yield the functions and classes of a module, and methods as "CLASS.METHOD"."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        if isinstance(node, ast.ClassDef):
            yield from (f"{node.name}.{name}" for name in _names(ast.Module(node.body, [])))


def main(arguments: list[str]) -> int:
    """Run one of the examinations; return the exit status."""
    if arguments[:1] == ["ask"]:
        for number, question in enumerate(read_questions(), 1):
            print(f"{number}. {question.text}")
        return 0
    if arguments[:1] == ["docstrings"] and len(arguments) == 2:
        for number, (_, docstring) in enumerate(draw_docstrings(int(arguments[1])), 1):
            print(f"--- {number}\n{docstring}\n")
        return 0
    if arguments:
        print(__doc__, file=sys.stderr)
        return 2
    problems = list(lost_answers())
    print("\n".join(problems) or f"{len(read_questions())} answers are in the code")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
