"""The house's bars: what misses one is found, what keeps it is not."""

from pathlib import Path

import pytest

from tools import house

FRONT = '_HOMES = {"zoo.open": ("open_zoo", "Partner"), "zoo.play": ("evaluate", "cross_play")}\n'
PROJECT = '[project]\nname = "toy"\ndependencies = ["jax"]\n'


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A house that keeps every bar."""
    write(tmp_path, "assistax_zoo/__init__.py", FRONT)
    write(tmp_path, "zoo/open.py", "from assistax_base import files\n")
    write(tmp_path, "zoo/play.py", "def play():\n    from zoo import open\n")
    write(tmp_path, "assistax_base/files.py", '"""Files."""\n\nx = 1\n')
    write(tmp_path, "pyproject.toml", PROJECT)
    return tmp_path


def write(root: Path, name: str, text: str) -> None:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def test_a_house_that_keeps_its_bars(root: Path) -> None:
    assert list(house.problems(root)) == []


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("zoo/long.py", "x = 1\n" * 351, "zoo/long.py: 351 lines, at most 350"),
        (
            "zoo/wide.py",
            f"def f({', '.join(f'a{i}' for i in range(13))}): ...\n",
            "zoo/wide.py: f has 13 parameters, at most 12",
        ),
        (
            "zoo/tall.py",
            "def f():\n" + "    x = 1\n" * 60,
            "zoo/tall.py: f has 61 lines, at most 60",
        ),
        (
            "zoo/asks.py",
            'def f(n):\n    raise ValueError(f"n is {n}; give more (--n 8)")\n',
            "zoo/asks.py:2: an option in an error",
        ),
        (
            "zoo/twice.py",
            "def merkle_root(leaves): ...\n",
            "zoo/twice.py: has a second copy of what stands in assistax_base/digest.py",
        ),
        (
            "zoo/asking.py",
            "def wants(split): return split.rule == PERSONS\n",
            "zoo/asking.py:1: refers to PERSONS",
        ),
    ],
)
def test_what_misses_a_bar_is_found(root: Path, name: str, text: str, problem: str) -> None:
    write(root, name, text)
    assert problem in house.problems(root)


def test_a_command_may_name_its_options(root: Path) -> None:
    write(root, "zoo/commands/shell.py", 'raise ValueError("give --n")\n')
    assert list(house.problems(root)) == []


def test_a_folder_of_thirteen_modules(root: Path) -> None:
    for i in range(13):
        write(root, f"zoo/full/m{i:02}.py", "")
    write(root, "zoo/full/m05_inside/module.py", "")  # a folder between them
    assert "zoo/full: 13 modules, at most 12" in house.problems(root)


def test_too_many_dependencies(root: Path) -> None:
    write(root, "pyproject.toml", f"[project]\ndependencies = {['jax'] * 21}\n")
    assert "dependencies of the core: 21, at most 20" in house.problems(root)


def test_rooms_that_import_each_other(root: Path) -> None:
    write(root, "zoo/open.py", "def f():\n    import zoo.play\n")
    assert "zoo: rooms import each other: open, play" in house.problems(root)


@pytest.mark.parametrize(
    "statement", ["import zoo.c", "def f():\n    from zoo import c", "from zoo.c import x"]
)
def test_circle_of_modules_is_found(root: Path, statement: str) -> None:
    write(root, "zoo/a.py", f"{statement}\n")
    write(root, "zoo/b.py", "from zoo.a import y\n")
    write(root, "zoo/c.py", "from zoo import b\n")
    assert "modules import each other: zoo.a, zoo.b, zoo.c" in house.problems(root)


def test_type_checkers_imports_make_no_circle(root: Path) -> None:
    guarded = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import zoo.b\n"
    write(root, "zoo/a.py", guarded)
    write(root, "zoo/b.py", "import zoo.a\n")
    assert house.circles(house.read_modules(root)) == []


def test_what_only_type_checkers_import_is_not_counted(root: Path) -> None:
    text = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from zoo import play\n"
    write(root, "zoo/open.py", text)
    modules = house.read_modules(root)
    assert modules["zoo.open"].imports(modules) == set()


def test_the_picture_of_the_rooms_is_true() -> None:
    text = (house.ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert house.picture(house.read_modules()) in text


def test_the_house_keeps_its_bars() -> None:
    assert list(house.problems()) == []
