"""The start page's example of the environments alone runs as it is printed."""

import re
from pathlib import Path

import pytest

START = Path(__file__).parents[2] / "docs" / "start.md"


@pytest.mark.slow
def test_the_example_of_the_environments_runs(capsys) -> None:
    (example,) = [
        code
        for code in re.findall(r"```python\n(.*?)```", START.read_text(), re.S)
        if "assistax_envs import" in code
    ]
    assert len(example.splitlines()) <= 15
    exec(compile(example, "start.md", "exec"), {})
    assert capsys.readouterr().out.startswith("(32, 34)")
