"""The core declares what it imports, and asks little of those who take partners and evaluate."""

import ast
import itertools
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[1]
PACKAGES = ("assistax_base", "assistax_envs", "population", "zoo", "evaluation", "assistax_zoo")
OURS = {*PACKAGES, "assistax_board", "assistax_workshop"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
NAMES = {  # of modules whose distribution is called otherwise
    "PIL": "pillow",
    "markupsafe": "jinja2",  # whose values they are
    "orbax": "orbax-checkpoint",
    "warp": "warp-lang",
}
# These need an extra as a whole: whoever imports them has it, or is told which one.
OF_EXTRAS = ("assistax_envs/adapters/", "population/trainers/", "population/runs/")


def declared(requirements: list[str]) -> set[str]:
    return {re.match(r"[\w-]+", text)[0] for text in requirements}  # ty: ignore


CORE = declared(PROJECT["dependencies"])
EXTRAS = {
    name
    for extra, requirements in PROJECT["optional-dependencies"].items()
    if extra not in ("dev", "docs")
    for name in declared(requirements)
}


def imports(tree: ast.AST) -> Iterator[tuple[str, bool]]:
    """Yield what is imported, and whether that is when the module is."""
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    lazy = {id(node) for function in functions for node in ast.walk(function)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, id(node) not in lazy) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield node.module, id(node) not in lazy
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "optional":
            named = node.args[0]  # another expression is checked where the module is imported
            yield from ((str(text), False) for text in [getattr(named, "value", None)] if text)


def undeclared(path: str, source: str) -> Iterator[str]:
    for module, at_once in imports(ast.parse(source)):
        name = module.partition(".")[0]
        if name in sys.stdlib_module_names or name in OURS:
            continue
        package = NAMES.get(name, name.replace("_", "-"))
        extra = package in EXTRAS and (not at_once or path.startswith(OF_EXTRAS))
        if package not in CORE and not extra:
            yield f"{path} imports {module}"


def test_the_core_asks_for_at_most_twenty_packages() -> None:
    assert len(PROJECT["dependencies"]) == len(CORE) <= 20


def test_every_import_of_the_core_is_declared() -> None:
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    assert len(files) > 150
    imports = [
        line
        for path in files
        for line in undeclared(path.relative_to(ROOT).as_posix(), path.read_text())
    ]
    assert imports == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("zoo/planted.py", "import requests"),
        ("zoo/planted.py", "def f():\n    import requests.sessions"),
        ("zoo/planted.py", "from cryptography import exceptions"),
        ("evaluation/planted.py", "optional('dask.array', 'a study', 'dask')"),
        ("population/runs/planted.py", "import sqlalchemy"),
    ],
)
def test_a_planted_import_is_found(path: str, source: str) -> None:
    assert len(list(undeclared(path, source))) == 1


def test_what_is_allowed_is_not_reported() -> None:
    source = "import numpy, json\nimport orbax.checkpoint\ndef f():\n    import cryptography"
    assert list(undeclared("population/runs/planted.py", source)) == []


def test_every_core_dependency_is_imported() -> None:
    used = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            names = {module.partition(".")[0] for module, _ in imports(ast.parse(path.read_text()))}
            used |= {NAMES.get(name, name.replace("_", "-")) for name in names}
    assert CORE - used == {"mujoco-mjx"}  # imported as mujoco.mjx


def test_the_lock_keeps_every_bound() -> None:
    lock = (ROOT / "requirements.lock").read_text()
    locked = dict(re.findall(r"^([\w-]+)==([\w.]+)", lock, re.MULTILINE))
    bounds: list[Requirement] = []
    for folder in ("", "workshop", "board"):
        project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        texts = [project["dependencies"], *project.get("optional-dependencies", {}).values()]
        bounds += map(Requirement, itertools.chain(*texts))
    kept = {bound.name: bound for bound in bounds if bound.name in locked}
    assert {"filelock", "fastapi", "uvicorn", "optax"} <= kept.keys()
    assert [str(b) for b in bounds if b.name in locked and locked[b.name] not in b.specifier] == []
