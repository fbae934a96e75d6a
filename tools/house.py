"""The house's bars, held against the code: imports, sizes and second copies.

`python -m tools.house` prints every figure beside its bar and fails where one is missed;
`python -m tools.house picture` writes the picture of the rooms into CONTRIBUTING.md, and
`python -m tools.house kinds` prints each place that asks which task or kind of partner it has.
"""

import ast
import collections
import dataclasses
import functools
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path

from tools import kinds

ROOT = Path(__file__).parents[1]
CORE = ("assistax_base", "assistax_envs", "population", "zoo", "evaluation", "assistax_zoo")
FOLDERS = {
    **{package: package for package in CORE},
    "assistax_workshop": "workshop/assistax_workshop",
    "assistax_board": "board/assistax_board",
}
MOST_DEPENDENCIES = 20
MOST_MODULES, MOST_LINES, MOST_FUNCTION_LINES, MOST_PARAMETERS = 12, 350, 60, 12
OPTION = re.compile(r"--[a-z][\w-]*")
# What may stand once, and where: a pattern of source text, and the one file that may hold it.
ONCE = {
    r"def (canonical_json|json_sha256)\(": "assistax_base/digest.py",
    r"json\.dumps\([^)]*\)\.encode\(\)\)\.hexdigest": "assistax_base/digest.py",
    r"def \w*merkle_root\(": "assistax_base/digest.py",
    r"def first_problem\(": "assistax_base/validated.py",
    r"\btrim_mean\(|def iqm\(": "assistax_base/statistics.py",
}


@dataclasses.dataclass(frozen=True)
class Module:
    """A module: its dotted name, file, text and tree."""

    name: str
    path: Path
    text: str
    tree: ast.Module

    @functools.cached_property
    def functions(self) -> list[ast.FunctionDef | ast.AsyncFunctionDef]:
        """All its functions and methods."""
        kinds = ast.FunctionDef, ast.AsyncFunctionDef
        return [node for node in ast.walk(self.tree) if isinstance(node, kinds)]

    def imports(self, modules: Mapping[str, "Module"]) -> set[str]:
        """Return those of our modules that it imports, inside functions too."""
        skipped = _type_checking(self.tree)
        names = set()
        for node in ast.walk(self.tree):
            if id(node) in skipped:
                continue
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inside = {f"{node.module}.{alias.name}" for alias in node.names} & modules.keys()
                names |= inside or {node.module}
        return names & modules.keys() - {self.name}


def read_modules(root: Path = ROOT) -> dict[str, Module]:
    """Return all modules of the distributions by name."""
    modules = {}
    for package, folder in FOLDERS.items():
        for path in sorted((root / folder).rglob("*.py")):
            parts = path.relative_to(root / folder).with_suffix("").parts
            name = ".".join((package, *parts)).removesuffix(".__init__")
            text = path.read_text(encoding="utf-8")
            modules[name] = Module(name, path, text, ast.parse(text))
    return modules


def problems(root: Path = ROOT) -> Iterator[str]:
    """Yield missed bars, each with its figure."""
    modules = read_modules(root)
    yield from _sizes(modules, root)
    yield from _raised_options(modules, root)
    yield from _second_copies(modules, root)
    if (count := dependencies(root)) > MOST_DEPENDENCIES:
        yield f"dependencies of the core: {count}, at most {MOST_DEPENDENCIES}"
    for package in FOLDERS:
        yield from floors(modules, package)[1]
    for circle in circles(modules):
        yield f"modules import each other: {', '.join(circle)}"
    yield from kind_questions(modules, root)


def dependencies(root: Path = ROOT) -> int:
    """Return how many dependencies the core declares."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return len(project["dependencies"])


def kind_questions(modules: Mapping[str, Module], root: Path = ROOT) -> Iterator[str]:
    """Yield the places that ask for a kind of task or partner, as "FILE:LINE: REASON"."""
    for module in modules.values():
        package = module.name.split(".")[0]
        place = module.path.relative_to((root / FOLDERS[package]).parent).as_posix()
        for line, reason in kinds.questions(module.tree, place):
            yield f"{module.path.relative_to(root).as_posix()}:{line}: {reason}"


def floors(modules: Mapping[str, Module], package: str) -> tuple[list[list[str]], list[str]]:
    """Return a package's rooms by floor, the lowest first, and which of them import each other.

    A room is a folder, or a module beside the folders; one stands above all that it imports.
    """
    arrows: dict[str, set[str]] = {}
    for module in modules.values():
        if module.name.startswith(f"{package}."):
            room = module.name.split(".")[1]
            below = {
                n.split(".")[1] for n in module.imports(modules) if n.startswith(f"{package}.")
            }
            arrows.setdefault(room, set()).update(below - {room})
    left, built = dict(arrows), []
    while left:
        floor = sorted(room for room, below in left.items() if not below & left.keys())
        if not floor:
            return built, [f"{package}: rooms import each other: {', '.join(sorted(left))}"]
        built.append(floor)
        left = {room: below for room, below in left.items() if room not in floor}
    return built, []


def circles(modules: Mapping[str, Module]) -> list[tuple[str, ...]]:
    """Return the groups of modules that import each other, directly or through others.

    Imports inside functions count, those of type checkers do not. Each group is sorted.
    """
    below = {name: module.imports(modules) for name, module in modules.items()}
    reached = {name: _reachable(name, below) for name in below}
    groups = {
        tuple(sorted({name} | {other for other in reached[name] if name in reached[other]}))
        for name in below
    }
    return sorted(group for group in groups if len(group) > 1)


def _reachable(name: str, below: Mapping[str, set[str]]) -> set[str]:
    """Return the modules that a module imports, directly or through others."""
    found: set[str] = set()
    left = set(below[name])
    while left:
        found |= left
        left = {lower for module in left for lower in below[module]} - found
    return found


def picture(modules: Mapping[str, Module]) -> str:
    """Return the rooms as Markdown: a line for each package, from the lowest floor up."""
    lines = [
        "| package | its rooms; each stands to the right of those that it imports |",
        "|---|---|",
    ]
    for package in FOLDERS:
        rooms = (", ".join(f"`{room}`" for room in floor) for floor in floors(modules, package)[0])
        lines.append(f"| `{package}` | {' ← '.join(rooms)} |")
    return "\n".join(lines)


def raised_options(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the options of the command line that a module's errors name, each with its line."""
    for raised in (node for node in ast.walk(tree) if isinstance(node, ast.Raise)):
        for node in ast.walk(raised):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield from ((node.lineno, option) for option in OPTION.findall(node.value))


def write_picture(root: Path = ROOT) -> bool:
    """Bring CONTRIBUTING's picture up to date; return whether it had to change."""
    path = root / "CONTRIBUTING.md"
    text = path.read_text(encoding="utf-8")
    rooms = re.compile(r"(?<=<!-- rooms -->\n).*(?=<!-- end of rooms -->)", re.DOTALL)
    if not rooms.search(text):
        raise ValueError(f"{path} has no place for the picture: its two comments are missing")
    new = rooms.sub(lambda _: picture(read_modules(root)) + "\n", text)
    path.write_text(new, encoding="utf-8")
    return new != text


def _sizes(modules: Mapping[str, Module], root: Path) -> Iterator[str]:
    paths = [m.path for m in modules.values() if m.path.name != "__init__.py"]
    for folder, count in sorted(collections.Counter(path.parent for path in paths).items()):
        if count > MOST_MODULES:
            yield f"{folder.relative_to(root)}: {count} modules, at most {MOST_MODULES}"
    homes = _literal(modules["assistax_zoo"].tree, "_HOMES")
    front = {(home, name) for home, names in homes.items() for name in names}
    for module in modules.values():
        place = module.path.relative_to(root)
        lines = len(module.text.splitlines())
        if lines > MOST_LINES:
            yield f"{place}: {lines} lines, at most {MOST_LINES}"
        for function in module.functions:
            if (module.name, function.name) in front:
                continue
            long = (function.end_lineno or 0) - function.lineno + 1
            arguments = function.args
            wide = len([*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs])
            if long > MOST_FUNCTION_LINES:
                yield f"{place}: {function.name} has {long} lines, at most {MOST_FUNCTION_LINES}"
            if wide > MOST_PARAMETERS and "commands" not in place.parts:
                yield f"{place}: {function.name} has {wide} parameters, at most {MOST_PARAMETERS}"


def _raised_options(modules: Mapping[str, Module], root: Path) -> Iterator[str]:
    """Yield errors that name an option of the command line, below the commands."""
    for module in modules.values():
        if {"commands", "shell"} & {*module.name.split(".")}:
            continue
        for line, _ in raised_options(module.tree):
            yield f"{module.path.relative_to(root)}:{line}: an option in an error"


def _second_copies(modules: Mapping[str, Module], root: Path) -> Iterator[str]:
    for module in modules.values():
        place = module.path.relative_to(root).as_posix()
        for pattern, home in ONCE.items():
            if place != home and re.search(pattern, module.text):
                yield f"{place}: has a second copy of what stands in {home}"


def _type_checking(tree: ast.Module) -> set[int]:
    """Return the ids of nodes that only type checkers read."""
    blocks = (
        n
        for n in ast.walk(tree)
        if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.unparse(n.test)
    )
    return {id(node) for block in blocks for node in ast.walk(block)}


def _literal(tree: ast.Module, name: str) -> dict[str, tuple[str, ...]]:
    """Return the dictionary that a module assigns to a name."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return ast.literal_eval(node.value)
    raise ValueError(f"the module has no {name} at its top")


def main(arguments: list[str]) -> int:
    """Print the count of dependencies and every missed bar; or run the named argument."""
    if arguments == ["picture"]:
        write_picture()
        return 0
    if arguments == ["kinds"]:
        places = list(kind_questions(read_modules()))
        packages = collections.Counter(place.partition("/")[0] for place in places)
        print("\n".join(places))
        print(", ".join(f"{package} {count}" for package, count in sorted(packages.items())))
        return bool(places)
    print(f"dependencies of the core: {dependencies()} (at most {MOST_DEPENDENCIES})")
    missed = list(problems())
    print("\n".join(missed))
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
