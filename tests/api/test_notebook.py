"""docs/notebook.ipynb does what it says, in a kernel."""

import importlib.util
import os
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
STEPS = 20  # of an episode, so that the cells take seconds
PREFACE = f"import assistax_envs.env\nassistax_envs.env.EPISODE_LENGTH = {STEPS}"


def notebook() -> Any:
    return nbformat.read(ROOT / "docs" / "notebook.ipynb", as_version=4)


def code_cells(content: Any) -> list[Any]:
    return [cell for cell in content.cells if cell.cell_type == "code"]


def test_it_is_short_and_holds_no_outputs() -> None:
    cells = code_cells(notebook())
    lines = [line for cell in cells for line in cell.source.splitlines() if line.strip()]
    assert len(lines) < 40
    assert not any(cell.outputs or cell.execution_count for cell in cells)


@pytest.mark.slow
def test_every_cell_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("PYTHONPATH", str(ROOT)), ("XDG_CACHE_HOME", str(tmp_path / "cache"))):
        monkeypatch.setenv(name, value)
    monkeypatch.delenv("JAX_NUMPY_RANK_PROMOTION", raising=False)  # strict in tests, not in Jupyter
    content = notebook()
    if importlib.util.find_spec("torch") is None:
        content.cells = [
            cell for cell in content.cells if "torch" not in cell.metadata.get("tags", ())
        ]
    content.cells.insert(0, nbformat.v4.new_code_cell(PREFACE))
    client = NotebookClient(content, timeout=300, resources={"metadata": {"path": str(tmp_path)}})
    client.execute()
    told = [
        output.get("text", "") + str(output.get("data", ""))
        for cell in code_cells(content)
        for output in cell.outputs
    ]
    shown = "\n".join(told)
    assert "<table" in shown and "self-play" in shown and "Comparison(scratch" in shown
    assert (tmp_path / "crossplay.png").stat().st_size > 1000
    assert os.listdir(tmp_path / "cache" / "assistax-zoo")
