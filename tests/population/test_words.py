"""Options of the command line are named by commands alone: libraries have other callers."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIBRARIES = (
    "assistax_envs",
    "population",
    "evaluation/ego_training.py",
    "workshop/assistax_workshop/plans",
    "workshop/assistax_workshop/sweep.py",
    "workshop/assistax_workshop/sweep_space.py",
)


def options_in_raises(source: str) -> list[str]:
    """Return what the errors of a file say of options."""
    return [
        word
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Raise)
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
        for word in re.findall(r"--[a-z][a-z-]*", part.value)
    ]


def test_no_error_of_a_library_names_an_option() -> None:
    planted = 'raise ValueError(f"{x} is there; choose another --out")'
    assert options_in_raises(planted) == ["--out"]
    places = [ROOT / name for name in LIBRARIES]
    files = [path for place in places for path in (place, *place.rglob("*.py")) if path.is_file()]
    assert len(files) > 80
    words = {str(path): options_in_raises(path.read_text(encoding="utf-8")) for path in files}
    assert {name: options for name, options in words.items() if options} == {}
