"""Write the documentation of options into the docstrings of `assistax_zoo.evaluating`.

An option of a command and an argument of a Python function are documented once: beside the fields
of `PlaySettings` and `PartnerChoice`, or in the command. `python -m tools.option_docs` copies the
text of each into the functions, whose docstrings make the Python reference.
"""

import ast
import re
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
WIDTH = 100
COMMANDS = "assistax_zoo/commands/evaluation/evaluate.py"
SETTINGS = ("evaluation/play/how.py", "PlaySettings")
PARTNERS = ("assistax_zoo/commands/options.py", "PartnerChoice")
FUNCTIONS = ROOT / "assistax_zoo/evaluating.py"
# Definitions that document the arguments of each function, as a file and a name.
SOURCES = {
    "evaluate": (SETTINGS, PARTNERS, (COMMANDS, "evaluate")),
    "cross_play": (SETTINGS, (COMMANDS, "crossplay")),
}
# Arguments that differ from the option of the same name.
DIFFERENT = {
    "evaluate": {"out"},
    "cross_play": {"robots", "humans", "out"},
}
ENTRY = re.compile(r"^ {8}([a-z]\w*): (.*(?:\n {12}.*)*)", re.MULTILINE)


def documented(text: str, name: str) -> dict[str, str]:
    """Return the documentation of each field or argument of a definition, on one line each.

    Args:
        text: Source of a module.
        name: Class or function at its top.
    """
    docstring = ast.get_docstring(_definition(text, name), clean=False) or ""
    return {match[1]: " ".join(match[2].split()) for match in ENTRY.finditer(docstring)}


def updated(text: str, root: Path = ROOT) -> str:
    """Return the source of the functions with the documentation of their sources.

    Args:
        text: Source of `assistax_zoo.evaluating`.
        root: Folder of the packages.
    """
    for function, sources in SOURCES.items():
        options: dict[str, str] = {}
        for path, name in sources:
            options |= documented((root / path).read_text(encoding="utf-8"), name)
        shared = options.keys() - DIFFERENT[function]
        lines = text.splitlines(keepends=True)
        definition = _definition(text, function)
        start, end = definition.body[0].lineno - 1, definition.body[0].end_lineno or 0
        entries = "".join(lines[start:end])
        for name in shared:
            entries = _replaced(entries, name, options[name])
        text = "".join((*lines[:start], entries, *lines[end:]))
    return text


def _definition(text: str, name: str) -> ast.ClassDef | ast.FunctionDef:
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return node
    raise ValueError(f"the module has no {name} at its top")


def _replaced(docstring: str, name: str, documentation: str) -> str:
    """Return a docstring with new documentation of an argument, if the docstring has it."""
    lines = textwrap.wrap(
        f"{name}: {documentation}",
        WIDTH,
        initial_indent=" " * 8,
        subsequent_indent=" " * 12,
        break_long_words=False,
        break_on_hyphens=False,
    )
    entry = re.compile(rf"^ {{8}}{name}: .*(?:\n {{12}}.*)*", re.MULTILINE)
    return entry.sub(lambda _: "\n".join(lines), docstring)


if __name__ == "__main__":
    FUNCTIONS.write_text(updated(FUNCTIONS.read_text(encoding="utf-8")), encoding="utf-8")
