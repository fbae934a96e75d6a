"""Options of the command line are named by commands alone: libraries have other callers."""

import ast
from pathlib import Path

from tools.house import raised_options

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
    return [option for _, option in raised_options(ast.parse(source))]


def test_no_error_of_a_library_names_an_option() -> None:
    planted = 'raise ValueError(f"{x} is there; choose another --out")'
    assert options_in_raises(planted) == ["--out"]
    places = [ROOT / name for name in LIBRARIES]
    files = [path for place in places for path in (place, *place.rglob("*.py")) if path.is_file()]
    assert len(files) > 80
    words = {str(path): options_in_raises(path.read_text(encoding="utf-8")) for path in files}
    assert {name: options for name, options in words.items() if options} == {}
