"""Runner of the notebooks in docs/, whose outputs it stores: `python -m tools.notebooks`."""

import base64
import importlib.util
import io
import os
import re
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs"
TIMEOUT = 600  # seconds of a cell
COLOURS = 256  # of a stored picture, which takes a third of the bytes of one with all colours
EMBEDDED = re.compile(r"(?<=data:image/png;base64,)[A-Za-z0-9+/=]+")


def names() -> list[str]:
    """Return the notebooks' names."""
    return sorted(path.stem for path in FOLDER.glob("*.ipynb"))


def run(name: str, folder: Path, preface: str = "") -> Any:
    """Return the notebook with the outputs of a run in `folder`, reduced by `keep`."""
    content = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    if preface:
        content.cells.insert(0, nbformat.v4.new_code_cell(preface))
    os.environ["PYTHONPATH"] = f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    resources = {"metadata": {"path": str(folder)}}
    needed = importlib.util.find_spec("torch"), importlib.util.find_spec("stable_baselines3")
    absent = "" if all(needed) else "torch"  # such cells keep their outputs
    client = NotebookClient(
        content, timeout=TIMEOUT, resources=resources, skip_cells_with_tag=absent
    )
    client.execute()
    if preface:
        content.cells.pop(0)
    return keep(content)


def keep(content: Any) -> Any:
    """Return a notebook without machine-specific data, and with small pictures.

    Machine-specific are messages, counters, times and versions.
    """
    for cell in content.cells:
        if cell.cell_type == "code":
            cell.execution_count = None
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
            for output in cell.outputs:
                if "execution_count" in output:
                    output["execution_count"] = None
                _reduce_pictures(output.get("data", {}))
        cell.metadata.pop("execution", None)
    content.metadata = {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    return content


def _reduce_pictures(data: dict[str, str]) -> None:
    """Reduce the pictures of an output in place: a PNG, or those that HTML embeds."""
    if "image/png" in data:
        data["image/png"] = reduced(data["image/png"])
    if "text/html" in data:
        data["text/html"] = EMBEDDED.sub(lambda found: reduced(found[0]), data["text/html"])


def reduced(picture: str) -> str:
    """Return a PNG in base64 with a palette of `COLOURS`, or the picture if that is smaller."""
    content = io.BytesIO()
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(content, "png", optimize=True)
    return min(base64.b64encode(content.getvalue()).decode(), picture, key=len)


def main(chosen: list[str]) -> None:
    """Run the notebooks and write them with their outputs."""
    for name in chosen or names():
        with tempfile.TemporaryDirectory() as folder:
            nbformat.write(run(name, Path(folder)), FOLDER / f"{name}.ipynb")
        print(name)


if __name__ == "__main__":
    main(sys.argv[1:])
