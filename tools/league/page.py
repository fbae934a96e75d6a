"""The results' page with its tables and figures, from folders of rows."""

import dataclasses
import json
import os
from pathlib import Path

import polars as pl
from matplotlib.figure import Figure

from assistax_base.files import atomic_write
from evaluation.figures.contrasts import read_contrasts
from evaluation.plots.league import league_chart
from evaluation.plots.style import save_figure
from tools.league.figures import failure_chart, failures, validation_curves
from tools.league.results import results_page
from tools.league.tables import beside, corrected, of_folders, read_tables
from zoo.registry import load_registry

FIGURES = {
    "league": "Mean return of each row with its 95% interval",
    "validation": "Return with the validation partners against steps, for each row that learned",
    "partners": "Share of the best row's return, for each row and partner",
}


def write_page(
    folder: Path,
    out: Path,
    images: Path,
    contrasts: Path | None = None,
    text: Path | None = None,
    earlier: Path | None = None,
) -> list[Path]:
    """Write tables as CSV, three figures and the page of all tasks of a folder; return their paths.

    Of each task: `TASK-league.csv`, `TASK-partners.csv` (failures of robots by partner), and
    `TASK-validation.csv`; of all tasks: `rows.csv` (steps and device minutes) and, with a file of
    contrasts, `contrasts.csv`; the figures `league.png`, `validation.png` and `partners.png`.

    Args:
        folder: Has a folder for each task, with one for each row, as `row` fills it.
        out: Of the tables.
        images: Of the figures.
        contrasts: File of named contrasts.
        text: The page to write.
        earlier: Tables of an earlier page; rows that the folder lacks stay as they are there.

    Raises:
        FileNotFoundError: The folder has no row of any task, or there are no earlier tables.
    """
    shown = of_folders(folder, contrasts)
    if earlier is not None:
        shown = beside(shown, read_tables(earlier))
    written = []
    named = None
    if contrasts is not None:
        named, digest = read_contrasts(contrasts)
        shown = dataclasses.replace(shown, contrasts=corrected(shown, named))
        about = {"file": contrasts.name, "sha256": digest}
        path = out / "contrasts.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, (json.dumps(about, indent=1) + "\n").encode())
        written.append(path)
    written += shown.write(out)
    shares = {task: failures(table) for task, table in shown.partners.items()}
    written += _figure(league_chart(shown.league), images / "league.png")
    written += _figure(failure_chart(shares), images / "partners.png")
    if shown.validation:
        curves = {task: _by_row(table) for task, table in shown.validation.items()}
        written += _figure(validation_curves(curves), images / "validation.png")
    if text is not None:
        near = {"images": images, "tables": out}
        figures = {
            name: what for name, what in FIGURES.items() if (images / f"{name}.png") in written
        }
        links = {what: os.path.relpath(path, text.parent) for what, path in near.items()}
        atomic_write(text, results_page(shown, named, links, figures, load_registry()).encode())
        written.append(text)
    return written


def _by_row(curves: pl.DataFrame) -> dict[str, pl.DataFrame]:
    parts = curves.partition_by("row", as_dict=True, maintain_order=True, include_key=False)
    return {str(row): table for (row,), table in parts.items()}


def _figure(figure: Figure, path: Path) -> list[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path, dpi=130)  # enough for a page, and a repository keeps each of them
    return [path]
