"""No name of a folder is a pattern: each is read as it is spelled, whatever lies beside it."""

import ast
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import assistax_zoo as az
from assistax_base.errors import ZooError
from assistax_base.parquet import check_readable, read_parquet
from evaluation.cast.egos import read_egos
from evaluation.plots.figures import curves_figure
from evaluation.record import tables
from evaluation.record.verification import check_sources, verify_folder
from population.config import Member, TrainConfig
from population.runs.folder import RunFolder
from tests.attack.commands import ROBOT, small_zoo
from tests.evaluation.test_sources import toy
from tests.untrained import params_of
from zoo.parameters.storage import write_policy_file

ROOT = Path(__file__).parents[2]
# Odd names, and what each would match as a pattern.
NEIGHBOURS = {
    "run[1]": "run1",
    "a*b": "axb",
    "?": "x",
    "[!a]": "b",
    "**": "y",
    "with space": "with",
    "ünïcode": "unicode",
    "{x}": "z",
    "~": "home",
    "file:": "file",
    "two\nlines": "two",
}
if sys.platform == "linux":
    NEIGHBOURS[os.fsdecode(b"no utf-8 \xff")] = "no utf-8 "

OTHERS, SLOW = [name for name in NEIGHBOURS if name != "run[1]"], pytest.mark.slow


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Results of two robots, which the tests find again under other names."""
    home = tmp_path_factory.mktemp("home")
    small_zoo(home / "zoo")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("assistax_envs.make", toy)
        for seed in (0, 1):
            evaluate(home, seed, home / f"robot{seed}")
        yield home


def evaluate(home: Path, seed: int, out: Path) -> az.EvaluationResult:
    robot = f"zoo:scratch/ippo-d1-s{seed}-v0/robot"
    options: Any = {"episodes": 1, "references": False, "include_own": True, "progress": False}
    return az.evaluate(robot, task="scratch", split="both", zoo=home / "zoo", out=out, **options)


@pytest.mark.parametrize("name", ["run[1]", *(pytest.param(n, marks=SLOW) for n in OTHERS)])
def test_a_result_is_that_of_its_folder(
    home: Path, tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # relative names too: "~" is no home, "file:" no address
    folder = Path(name)
    shutil.copytree(home / "robot0", NEIGHBOURS[name])
    first_result = evaluate(home, 1, folder)
    assert [path.name for path in tmp_path.iterdir() if path.name == name] == [name]
    assert first_result.to_json()["env_steps_per_second"] is not None  # it was played, here
    again, expected = evaluate(home, 1, folder), az.load_result(home / "robot1")
    assert again.to_json()["env_steps_per_second"] is None
    for result in (again, az.load_result(folder)):
        assert result.episodes.equals(expected.episodes)
    assert isinstance(expected, az.EvaluationResult)
    assert az.compare(folder, home / "robot1").test == az.compare(expected, expected).test
    assert again.partners.equals(expected.partners)
    again.report(tmp_path / "page.html")
    again.plot(tmp_path / "profile.png", "profile")
    assert verify_folder(folder).ok and not check_sources(folder).problems


@pytest.mark.parametrize("name", NEIGHBOURS)
def test_metrics_are_those_of_their_run(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    config = TrainConfig("scratch", "ippo", (Member(0, "d1"),), 64)
    for place, value in ((NEIGHBOURS[name], 1.0), (name, 2.0)):
        run = RunFolder(Path(place))
        run.open(config, {}, resume=False)
        row = {"update": 0, "steps": 64, "member": 0, "disability": "d1", "seed": 0}
        run.write_metrics(pl.DataFrame([{**row, "return": value, "episodes": 1}]))
    assert RunFolder(Path(name)).read_metrics(0)["return"].to_list() == [2.0]
    curves_figure(Path(name), tmp_path / "curves.png")


def test_folder_name_with_newline_shows_damaged_file(tmp_path: Path) -> None:
    folder = tmp_path / "two\nlines"
    folder.mkdir()
    tables.write_parquet(pl.DataFrame({"v": [1]}), folder / "a.parquet")
    (folder / "b.parquet").write_bytes(b"PAR1 torn")
    with pytest.raises(ValueError, match=r"b\.parquet is not a readable Parquet file"):
        check_readable([folder / "a.parquet", folder / "b.parquet"])


def test_a_robot_is_that_of_its_folder(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    registry = az.open_zoo(home / "zoo").registry
    monkeypatch.chdir(tmp_path)
    for folder, names in (("run[1]", ["a-s0", "a-s1"]), ("run1", ["a-s0", "a-s1", "b"])):
        Path(folder).mkdir()
        for seed, name in enumerate(names):
            write_policy_file(Path(folder, f"{name}.safetensors"), ROBOT, params_of(ROBOT, seed))

    def ids(robot: Path | str) -> list[str]:
        return list(read_egos([robot], registry, "scratch").ids)

    assert ids("run[1]/*.safetensors") == [f"run[1]/a-s{seed}.safetensors" for seed in (0, 1)]
    assert ids("run?/*-s0.safetensors") == ["run1/a-s0.safetensors"]
    name = "run[1]/b.safetensors"
    for missing in (name, Path(name), Path("run?/b.safetensors")):  # a path is no glob
        with pytest.raises((ValueError, ZooError), match=r"b\.safetensors"):
            ids(missing)


def _by_path(tree: ast.AST) -> set[ast.AST]:
    """Return all nodes but functions that get bytes, such as `pl.read_csv(path.read_bytes())`."""
    given = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    of_bytes = {node.func for node in given if ast.unparse(node.args[0]).endswith(".read_bytes()")}
    return {*ast.walk(tree)} - of_bytes


def test_only_one_module_reads_parquet_by_path() -> None:
    """Polars takes a path for a pattern unless it is told not to, which is told in one place."""
    packages = ("assistax_base", "assistax_envs", "population", "zoo", "evaluation", "assistax_zoo")
    files = [path for name in (*packages, "tools") for path in (ROOT / name).rglob("*.py")]
    reads = {
        path.relative_to(ROOT).as_posix()
        for path in files
        for node in _by_path(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
        if node.value.id in ("pl", "polars") and node.attr.startswith(("read_", "scan_"))
    }
    assert reads == {"assistax_base/parquet.py"}
    assert read_parquet is tables.parquet.read_parquet
