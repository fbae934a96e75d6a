"""The README's example of the environments alone runs as it is printed."""

import re
from pathlib import Path

README = Path(__file__).parents[2] / "README.md"


def test_the_example_of_the_environments_runs(capsys) -> None:
    (example,) = [
        code
        for code in re.findall(r"```python\n(.*?)```", README.read_text(), re.S)
        if "make(" in code
    ]
    assert len(example.splitlines()) <= 15
    exec(compile(example, "README.md", "exec"), {})
    assert capsys.readouterr().out.startswith("(32, 34)")
