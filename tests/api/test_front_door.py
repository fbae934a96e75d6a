"""`import assistax_zoo`: light, complete, and refusing what would stand in its place."""

import doctest
import importlib
import inspect
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import assistax_zoo as az

ROOT = Path(__file__).parents[2]
HEAVY = {"jax", "mujoco", "numpy", "polars", "matplotlib", "pydantic", "flax", "scipy", "rich"}


def python(*words: str, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_importing_loads_nothing_heavy() -> None:
    done = python("-c", "import assistax_zoo as az, sys; dir(az); print(*sys.modules)")
    assert done.returncode == 0 and not HEAVY & set(done.stdout.split())


def test_reading_the_registry_loads_no_arrays() -> None:
    read = "from zoo.registry import load_registry; load_registry('registry.json')"
    done = python("-c", f"import sys; {read}; print(*sys.modules)")
    assert done.returncode == 0 and not (HEAVY - {"pydantic", "rich"}) & set(done.stdout.split())


def test_every_name_is_typed_and_has_an_example() -> None:
    assert dir(az) == az.__all__ == sorted(az.__all__)
    source = (ROOT / "assistax_zoo" / "__init__.py").read_text(encoding="utf-8")
    checked = source[source.index("TYPE_CHECKING:") : source.index("__all__")]
    for name in az.__all__:
        value = getattr(az, name)
        assert name in checked
        assert ">>> " in (inspect.getdoc(value) or ""), f"{name} has no example"
        members = vars(value).values() if inspect.isclass(value) else ()
        for function in filter(inspect.isfunction, (value, *members)):
            if not function.__name__.startswith("_"):
                assert inspect.getdoc(function), f"{name}: {function.__name__}"
                typed = {*function.__annotations__, "self"}
                assert set(inspect.signature(function).parameters) <= typed


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(AttributeError, match=r"no attribute 'evalute'; it offers .*evaluate"):
        _ = az.evalute


@pytest.mark.parametrize("shadow", ["zoo.py", "evaluation/__init__.py", "population/x.py"])
def test_shadowing_module_is_refused_by_name(tmp_path: Path, shadow: str) -> None:
    (tmp_path / shadow).parent.mkdir(exist_ok=True)
    (tmp_path / shadow).write_text("")
    name = Path(shadow).parts[0]
    path = f"import sys; sys.path.insert(0, {str(tmp_path)!r})"
    done = python("-c", f"{path}\nimport assistax_zoo as az\naz.evaluate", folder=tmp_path)
    if shadow == "population/x.py":  # a folder without __init__ gives way to a package
        assert done.returncode == 0
    else:
        words = f"ImportError: {tmp_path / name} has the name of a package of assistax-zoo"
        assert words in done.stderr


def test_command_refuses_shadowing_module_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "assistax_envs.py").write_text("")
    done = python("-m", "assistax_zoo", "list", folder=tmp_path)
    assert done.returncode == 1 and done.stdout == ""
    words = f"error: {tmp_path / 'assistax_envs.py'} has the name of a package"
    assert done.stderr.startswith(words)
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "module",
    [
        "assistax_zoo.zoos",
        "assistax_zoo.evaluating",
        "assistax_zoo.results",
        "assistax_zoo.comparing",
        "evaluation.figures.metrics.variance",
        "evaluation.cast.partners",
        "evaluation.figures.planning",
        "assistax_zoo.films",
        "assistax_zoo.recording",
        pytest.param("assistax_zoo.training", marks=pytest.mark.slow),
        pytest.param("assistax_workshop.auditing", marks=pytest.mark.slow),
    ],
)
def test_examples_run(module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 20)
    monkeypatch.chdir(tmp_path)
    received: dict[str, Any] = {}
    if module in ("assistax_zoo.results", "assistax_zoo.comparing"):
        options: dict[str, Any] = {"task": "scratch", "episodes": 1, "progress": False}
        near = {"split": "both", "partners": "scratch/ippo-d1-s[01]-v1", "references": False}
        received["result"] = az.evaluate(lambda obs: obs[:, :7] * 0.0, **options, **near)
        team = "scratch/ippo-d1-s0-v1"
        received["matrix"] = az.cross_play(team, team, **options)
    loaded = importlib.import_module(module)
    done = doctest.testmod(loaded, extraglobs=received, optionflags=doctest.ELLIPSIS)
    assert done.attempted and not done.failed
