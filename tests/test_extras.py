"""Every extra that docs, messages and docstrings name can be installed."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CORE = ("assistax_base", "assistax_envs", "population", "zoo", "evaluation", "assistax_zoo")
# A distribution as pip takes it, or the core's extra in prose; ours, never JAX's.
NAMED = re.compile(
    r"(?:assistax-zoo|(?<=['\"])\.|(?:\./)?\b(?P<other>board|workshop)|"
    r"assistax-zoo-(?P<long>board|workshop))\[(?P<names>[\w,]+)\]"
    r"|\bextras? `(?P<before>\w+)`|`(?P<after>\w+)` extra\b"
)


def extras(folder: str = ".") -> set[str]:
    project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
    return set(project.get("optional-dependencies", ()))


def unknown(text: str) -> Iterator[str]:
    """Yield each extra of the text that does not exist, as it is named there."""
    for match in NAMED.finditer(text):
        known = extras(match["other"] or match["long"] or ".")
        names = match["names"] or match["before"] or match["after"]
        if not set(names.split(",")) <= known:
            yield match[0]


def files() -> list[Path]:
    beside = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "Makefile")]
    docs = [*(ROOT / "docs").rglob("*.md"), *(ROOT / "docs").glob("*.ipynb")]
    code = [path for package in CORE for path in (ROOT / package).rglob("*.py")]
    code += [path for name in ("board", "workshop") for path in (ROOT / name).rglob("*.py")]
    return beside + docs + code


def test_every_extra_that_is_named_exists() -> None:
    wrong = {
        path.relative_to(ROOT).as_posix(): names
        for path in files()
        if (names := list(unknown(path.read_text(encoding="utf-8"))))
    }
    assert wrong == {}


def test_extras_are_named_at_all() -> None:
    text = "\n".join(path.read_text(encoding="utf-8") for path in files())
    named = {name for match in NAMED.finditer(text) for name in (match["names"] or "").split(",")}
    assert {"cuda12", "cuda13", "train", "video", "export", "adapters", "ray"} <= named


@pytest.mark.parametrize(
    "text",
    [
        "pip install 'assistax-zoo[warp]'",
        "pip install '.[export,warp]'",
        "pip install './board[redis]'",
        "pip install assistax-zoo-board[redis]",
        "needs the extra `warp`",
        "with the `warp` extra",
    ],
)
def test_a_planted_extra_is_found(text: str) -> None:
    assert len(list(unknown(text))) == 1


@pytest.mark.parametrize(
    "text",
    ["pip install 'jax[cuda12]'", "pip install '.[cuda12]' './board[s3]'", "shards[keys]", "x.[1]"],
)
def test_what_exists_or_is_not_ours_passes(text: str) -> None:
    assert list(unknown(text)) == []
