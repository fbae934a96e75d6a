"""The page of the tasks: its example runs as it is printed, its table has the tasks' sizes."""

import re
from pathlib import Path

import pytest

from assistax_envs import TASKS, make

PAGE = Path(__file__).parents[2] / "docs" / "environments.md"


@pytest.mark.slow
def test_the_example_of_the_environments_runs(capsys) -> None:
    (example,) = [
        code
        for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
        if "assistax_envs import" in code
    ]
    assert len(example.splitlines()) <= 15
    exec(compile(example, "environments.md", "exec"), {})
    assert capsys.readouterr().out.startswith("(32, 34)")


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_the_table_has_the_sizes_of_observations(task: str) -> None:
    sizes = make(task).observation_size
    found = re.findall(rf"^\| `{task}` \|.*\| (\d+ / \d+ / \d+) \|", PAGE.read_text(), re.M)
    assert found == [f"{sizes['robot']} / {sizes['human']} / {sizes['global']}"]


@pytest.mark.slow
def test_guides_have_the_sizes_of_their_task() -> None:
    """Start and the guide of a robot print one for gentle scratch."""
    size = make("gentle_scratch").observation_size["robot"]
    for name in ("start.md", "robot.md"):
        text = (PAGE.parent / name).read_text()
        printed = {int(number) for number in re.findall(r"\((\d+), (?:7|64)\)", text)}
        assert printed - {64} == {size}, name
