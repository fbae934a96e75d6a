"""Who may import whom, and what the light commands must not import."""

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from tools.house import raised_options

ROOT = Path(__file__).parents[1]

# Each package may import itself and what is listed: a package, or single modules of it.
CORE = ("assistax_base", "assistax_envs", "population", "zoo", "evaluation", "assistax_zoo")
FOLDERS = {"assistax_workshop": "workshop", "assistax_board": "board"}
LAYERS = {
    "assistax_base": (),
    "assistax_envs": ("assistax_base",),
    "population": ("assistax_base", "assistax_envs"),
    "zoo": (
        "assistax_base",
        "population.networks",
        "assistax_envs.versions",
        "assistax_envs.disability",
        "assistax_envs.preferences",
        "assistax_envs.persons",
        "assistax_envs.own_settings",
    ),
    "evaluation": ("assistax_base", "assistax_envs", "population", "zoo"),
    "assistax_zoo": ("assistax_base", "assistax_envs", "population", "zoo", "evaluation"),
    "assistax_workshop": CORE,
    "assistax_board": (*CORE, "assistax_workshop.plans"),
}
# The one name of the front door that another distribution brings; it is loaded when it is used.
EXCEPTIONS = {("assistax_zoo/__init__.py", "assistax_workshop.auditing.audit")}
HEAVY = ("jax", "mujoco", "flax", "matplotlib", "scipy")


def test_packages_import_only_the_layers_below() -> None:
    assert list(violations(ROOT)) == []


@pytest.mark.parametrize(
    ("package", "statement"),
    [
        ("assistax_envs", "import zoo"),
        ("assistax_envs", "def f():\n    from population.networks.spec import PolicySpec"),
        ("population", "from zoo import registry"),
        ("population", "import numpy, zoo.registry as registry"),
        ("zoo", "from population.trainers import ppo"),
        ("zoo", "import assistax_envs"),
        ("zoo", "from population.networking.spec import PolicySpec"),
        ("zoo", "import importlib\nimportlib.import_module('population.play.rollout')"),
        ("evaluation", "from assistax_zoo.shell.console import print_json"),
        ("evaluation", "from . import statistics"),
    ],
)
def test_a_planted_violation_is_found(tmp_path: Path, package: str, statement: str) -> None:
    plant(tmp_path, package, statement)
    [violation] = violations(tmp_path)
    assert violation.startswith(f"{package}/planted.py:")


@pytest.mark.parametrize(
    ("package", "statement"),
    [
        ("zoo", "from population.networks import spec"),
        ("zoo", "from population.networks.spec import PolicySpec"),
        ("evaluation", "import zoo.registry"),
        ("population", "import zoology"),
    ],
)
def test_what_is_allowed_is_not_reported(tmp_path: Path, package: str, statement: str) -> None:
    plant(tmp_path, package, statement)
    assert list(violations(tmp_path)) == []


def test_command_line_and_registry_import_nothing_heavy() -> None:
    commands = [
        f"assistax_zoo.commands.{path.stem}"
        for path in (ROOT / "assistax_zoo/commands").glob("[!_]*.py")
    ]
    assert (
        heavy_imports(
            "assistax_zoo.shell.main", "assistax_zoo.shell.console", "zoo.registry", *commands
        )
        == []
    )


def test_an_evaluation_waits_for_neither_scipy_nor_matplotlib() -> None:
    heavy = heavy_imports("assistax_zoo.evaluating", "assistax_envs.env", "evaluation.cast.egos")
    assert heavy == ["jax", "mujoco"]  # and for Flax only where networks play


def test_a_heavy_import_is_found() -> None:
    assert heavy_imports("zoo.registry", "matplotlib") == ["matplotlib"]


def test_annotations_are_checked_in_tests() -> None:
    from assistax_base.statistics import performance_profile
    from zoo.ids import parse_team

    with pytest.raises(TypeError, match="violates type hint"):
        parse_team(3)
    with pytest.raises(TypeCheckError):
        performance_profile(np.ones(2), np.ones((1, 2)))


def violations(root: Path) -> Iterator[str]:
    for package, allowed in LAYERS.items():
        for path in sorted((root / FOLDERS.get(package, "") / package).rglob("*.py")):
            for line, name in imports(
                ast.parse(path.read_text(encoding="utf-8"), filename=str(path))
            ):
                place = path.relative_to(root).as_posix()
                if (
                    name.split(".")[0] in (*LAYERS, "")
                    and not is_within(name, (package, *allowed))
                    and (place, name) not in EXCEPTIONS
                ):
                    yield f"{place}:{line} imports {name or 'relatively'}"


def imports(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and full name of what is imported; a relative import has the empty name."""
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=aliases):
                yield from ((node.lineno, alias.name) for alias in aliases)
            case ast.ImportFrom(level=0, module=str(module), names=aliases):
                yield from ((node.lineno, f"{module}.{alias.name}") for alias in aliases)
            case ast.ImportFrom():
                yield node.lineno, ""
            case ast.Call(
                func=ast.Attribute(attr="import_module"), args=[ast.Constant(value=str(name)), *_]
            ):
                yield node.lineno, name


def is_within(name: str, places: tuple[str, ...]) -> bool:
    return any(name == place or name.startswith(f"{place}.") for place in places)


def plant(root: Path, package: str, statement: str) -> None:
    (root / package).mkdir()
    (root / package / "planted.py").write_text(f"import os\n{statement}\n", encoding="utf-8")


def heavy_imports(*modules: str) -> list[str]:
    """Names from HEAVY that a fresh interpreter has loaded after importing the modules."""
    script = (
        "import importlib, json, sys\nfor name in sys.argv[1:]: importlib.import_module(name)\n"
    )
    script += f"print(json.dumps([name for name in {HEAVY!r} if name in sys.modules]))"
    result = subprocess.run(
        [sys.executable, "-c", script, *modules],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    return json.loads(result.stdout)


# Rooms whose errors hold for Python and for a shell alike.
QUIET = ("evaluation/cast", "evaluation/play", "evaluation/film.py", "evaluation/evaluate.py")
QUIET += ("evaluation/crossplay.py",)


def test_library_errors_name_no_option() -> None:
    paths = [path for room in QUIET for path in ((ROOT / room).rglob("*.py"), [ROOT / room])]
    files = [path for some in paths for path in some if path.suffix == ".py"]
    assert len(files) > 20
    assert [text for path in files for text in options_raised(path.read_text("utf-8"))] == []


def test_an_option_in_an_error_is_found() -> None:
    assert options_raised('raise ValueError(f"{n}; give more (--episodes {n})")') == ["--episodes"]
    assert options_raised('text = "--episodes"') == []


def options_raised(source: str) -> list[str]:
    """Return the options that raised texts name."""
    return [option for _, option in raised_options(ast.parse(source))]
