"""The notebooks under docs/ do what they say, in a kernel, and keep what they showed."""

import base64
import io
import json
import os
import re
from pathlib import Path
from typing import Any

import nbformat
import numpy as np
import pytest
from PIL import Image

from tools import notebooks

STEPS = {"my_robot": 300}  # of an episode; else 20, so that the cells take seconds
LEARNING = ("best_response", "custom_task")  # in episodes of full length, or they learn nothing
ELSEWHERE = ("stable_baselines",)  # run by tests/frameworks
MACHINE = re.compile(r"/(?:tmp|home|root|work|usr|var|Users)/|ipykernel|Traceback")


def cells(content: Any) -> list[Any]:
    return [cell for cell in content.cells if cell.cell_type == "code"]


def shown(content: Any) -> str:
    """Return all that the cells of a notebook show but pictures."""
    outputs = [output for cell in cells(content) for output in cell.outputs]
    texts = [
        text
        for output in outputs
        for kind, text in {"text": output.get("text", ""), **output.get("data", {})}.items()
        if not kind.startswith("image/")
    ]
    return "\n".join(texts)


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.delenv("JAX_NUMPY_RANK_PROMOTION", raising=False)  # strict in tests, not in Jupyter


@pytest.mark.parametrize("name", notebooks.names())
def test_notebook_is_short_and_keeps_its_outputs(name: str) -> None:
    content = nbformat.read(notebooks.FOLDER / f"{name}.ipynb", as_version=4)
    nbformat.validate(content)
    lines = [line for cell in cells(content) for line in cell.source.splitlines() if line.strip()]
    assert len(lines) < 65
    assert sum(bool(cell.outputs) for cell in cells(content)) >= 4
    assert not MACHINE.search(shown(content))
    assert not any(cell.execution_count for cell in cells(content))
    assert len(json.dumps(content)) < 400_000


def test_stored_pictures_are_reduced_wherever_they_stand() -> None:
    drawn = io.BytesIO()
    pixels = np.random.default_rng(0).integers(0, 255, (100, 100, 3), np.uint8)
    Image.fromarray(pixels).save(drawn, "png")
    picture = base64.b64encode(drawn.getvalue()).decode()
    html = f'<img src="data:image/png;base64,{picture}">'
    output = nbformat.v4.new_output("display_data", {"image/png": picture, "text/html": html})
    cell = nbformat.v4.new_code_cell(outputs=[output])
    kept = notebooks.keep(nbformat.v4.new_notebook(cells=[cell])).cells[0].outputs[0].data
    smaller = kept["image/png"]
    assert len(smaller) < len(picture) / 2 and notebooks.reduced(smaller) == smaller
    assert kept["text/html"] == html.replace(picture, smaller)
    assert Image.open(io.BytesIO(base64.b64decode(smaller))).size == (100, 100)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({*notebooks.names()} - {*LEARNING, *ELSEWHERE}))
def test_every_cell_runs(name: str, tmp_path: Path) -> None:
    kept = nbformat.read(notebooks.FOLDER / f"{name}.ipynb", as_version=4)
    length = f"assistax_envs.env.EPISODE_LENGTH = {STEPS.get(name, 20)}"
    content = notebooks.run(name, tmp_path, f"import assistax_envs.env\n{length}")
    for before, after in zip(cells(kept), cells(content), strict=True):
        assert [sorted(output.get("data", ())) for output in before.outputs] == [
            sorted(output.get("data", ())) for output in after.outputs
        ]
    printed = shown(content)
    if name == "notebook":
        assert "<table" in printed and "self-play" in printed and "Comparison(scratch" in printed
        assert (tmp_path / "crossplay.png").stat().st_size > 1000
        assert os.listdir(tmp_path / "cache" / "assistax-zoo")


@pytest.mark.slow
@pytest.mark.parametrize("name", LEARNING)
def test_notebook_learns(name: str, tmp_path: Path) -> None:
    """As much as the notebook says: the last cell but those that evaluate shows first and last."""
    for content in (
        nbformat.read(notebooks.FOLDER / f"{name}.ipynb", as_version=4),
        notebooks.run(name, tmp_path),
    ):
        first, last = map(int, re.findall(r"^\((\d+), (\d+)\)$", shown(content), re.MULTILINE)[0])
        assert last > 1.5 * first
