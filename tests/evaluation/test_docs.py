"""The newcomer's path of docs/robot.md and docs/zoo.md, as it is printed there."""

import json
import re
import sys
from pathlib import Path

import pytest

from assistax_zoo.shell.main import run
from zoo.registry import load_registry
from zoo.splitting.create import create_split

ROOT = Path(__file__).parents[2]
GUIDE = ROOT / "docs" / "robot.md"


def printed(name: str) -> str:
    """Return the code block that follows the file's name."""
    match = re.search(
        rf"`{name}\.py`:\n\n```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL
    )
    assert match is not None
    return match.group(1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["numpy_robot", "torch_robot"])
def test_my_robot_against_the_zoo_in_ten_lines(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    if name == "torch_robot":
        pytest.importorskip("torch", reason="the same with PyTorch, where it is installed")
    lines = [line.strip() for line in printed(name).splitlines()]
    assert len([line for line in lines if line and line[0] != "#"]) <= 10
    (tmp_path / f"{name}.py").write_text(printed(name))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr("assistax_envs.env.EPISODE_LENGTH", 10)
    words = ["evaluate", "--task", "gentle_scratch", "--episodes", "1", "--backend", "native"]
    words += ["--partners", "gentle_scratch/person-0900[12]-v1/human", "--split", "both"]
    assert run([*words, f"python:{name}:make", "--no-references", "--json"]) == 0
    summary = json.loads(capfd.readouterr().out)
    assert summary["egos"] == [f"python:{name}:make"]
    assert summary["episodes"] == 2


@pytest.mark.slow
def test_docs_split_by_behaviour_is_reproduced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs" / "zoo.md").read_text(encoding="utf-8")
    [example] = re.findall(r"```python\n(.*?create_split.*?)```", page, re.DOTALL)
    before = (ROOT / "registry.json").read_bytes()
    monkeypatch.setenv("ASSISTAX_ZOO_DATA", str(tmp_path / "data"))
    (tmp_path / "xp").symlink_to(ROOT / "docs" / "data" / "paper" / "crossplay" / "scratch")
    monkeypatch.chdir(tmp_path)
    exec(example, {})
    few = create_split(task="scratch", rule="small-train")
    registry = load_registry()
    assert (ROOT / "registry.json").read_bytes() == before
    half, clusters = registry.split("scratch"), registry.split("scratch", "custom")
    assert len(few.train) == 5 and set(few.train) < set(half.train) and few.test == half.test
    assert len(clusters.test) == 68 and len(clusters.train) == 130
