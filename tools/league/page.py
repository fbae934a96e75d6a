"""The results' page with its tables and figures, from folders of rows."""

import json
import os
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from assistax_base.bounded_reading import parse_json
from assistax_base.files import atomic_write
from assistax_zoo.comparing import compare_named
from evaluation.figures.contrasts import Contrast, ContrastFigures, read_contrasts
from evaluation.figures.league import league_table, ordered, read_league, row_folders
from evaluation.plots.league import league_chart
from evaluation.plots.style import save_figure
from evaluation.record import tables
from evaluation.validation import CURVE
from tools.league.figures import failure_chart, failures, validation_curves
from tools.league.making import RECORD, RUNS, TRAINING_SIDE
from tools.league.results import Played, results_page
from tools.league.rows import rows

FIGURES = {
    "league": "Mean return of each row with its 95% interval",
    "validation": "Return with the validation partners against steps, for each row that learned",
    "partners": "Share of the best row's return, for each row and partner",
}


def write_page(
    folder: Path, out: Path, images: Path, contrasts: Path | None = None, text: Path | None = None
) -> list[Path]:
    """Write tables as CSV, three figures and the page of all tasks of a folder; return their paths.

    Of each task: `TASK-league.csv`, `TASK-partners.csv` (who fails with whom), and
    `TASK-validation.csv`; of all tasks: `rows.csv` (steps and device minutes) and, with a file of
    contrasts, `contrasts.csv`; the figures `league.png`, `validation.png` and `partners.png`.

    Args:
        folder: Has a folder for each task, with one for each row, as `row` fills it.
        out: Of the tables.
        images: Of the figures.
        contrasts: File of named contrasts.
        text: The page to write.

    Raises:
        FileNotFoundError: The folder has no row of any task.
    """
    places = sorted(place for place in folder.glob("*") if row_folders(place))
    if not places:
        raise FileNotFoundError(f"{folder} has no folder of a task with rows; make some with `row`")
    of_folder = {place: _curves(place) for place in places}
    played = [
        Played(read_league(place), place, _validated(some)) for place, some in of_folder.items()
    ]
    trained = [
        Played(read_league(side), side, task.validated)
        for task in played
        if row_folders(side := task.folder / TRAINING_SIDE)
    ]
    league = {task.task: league_table(task.league) for task in played}
    shares = {task.task: failures(task.league.by_partner) for task in played}
    curves = {task.task: some for task in played if (some := of_folder[task.folder])}
    records = pl.DataFrame(_records(places))
    named = {"league": league, "partners": shares}
    named["training-side"] = {task.task: league_table(task.league) for task in trained}
    named["validation"] = {task: _long(some) for task, some in curves.items()}
    written = [
        _csv(table, out / f"{task}-{what}.csv")
        for what, by_task in named.items()
        for task, table in by_task.items()
    ]
    written += _figure(league_chart(league), images / "league.png")
    written += _figure(failure_chart(shares), images / "partners.png")
    if curves:
        written += _figure(validation_curves(curves), images / "validation.png")
    written.append(_csv(records, out / "rows.csv"))
    tested: ContrastFigures | None = None
    asked: tuple[Contrast, ...] = ()
    if contrasts is not None:
        asked = read_contrasts(contrasts)[0].contrasts
        methods = [place for task in places for place in row_folders(task).values()]
        tested = compare_named(contrasts, methods)
        written.append(_csv(_contrast_table(tested), out / "contrasts.csv"))
        about = {"file": tested.file, "sha256": tested.sha256, "notes": list(tested.notes)}
        path = out / "contrasts.json"
        atomic_write(path, (json.dumps(about, indent=1) + "\n").encode())
        written.append(path)
    if text is not None:
        near = {"images": images, "tables": out}
        shown = {name: what for name, what in FIGURES.items() if curves or name != "validation"}
        links = {what: os.path.relpath(path, text.parent) for what, path in near.items()}
        page = results_page(played, tested, asked, records, links, shown, trained)
        atomic_write(text, page.encode())
        written.append(text)
    return written


def _curves(task: Path) -> dict[str, pl.DataFrame]:
    """Return the learning curves of a task's rows."""
    return {
        row: tables.read_parquet(path)
        for row in ordered(place.name for place in (task / RUNS).glob("*"))
        if (path := task / RUNS / row / "training" / CURVE).is_file()
    }


def _validated(curves: dict[str, pl.DataFrame]) -> dict[str, float]:
    """Return what each row's robots earn with the validation side, each at its best checkpoint."""
    best = pl.col("return").max().over("seed").mean()
    return {row: float(curve.select(best).item()) for row, curve in curves.items()}


def _long(curves: dict[str, pl.DataFrame]) -> pl.DataFrame:
    return pl.concat(
        curve.select(pl.lit(row).alias("row"), pl.all()) for row, curve in curves.items()
    )


def _figure(figure: Figure, path: Path) -> list[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
    return [path]


def _csv(table: pl.DataFrame, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, table.write_csv(float_precision=3).encode())
    return path


def _records(tasks: list[Path]) -> list[dict[str, Any]]:
    """Return what rows say of their making, those of `row` alone."""
    shown = ("task", "row", "robots", "steps", "total_steps", "device", "device_minutes_in_all")
    found = []
    for task in tasks:
        for name in row_folders(task):
            path = task / RUNS / name / RECORD
            record = parse_json(path.read_text(encoding="utf-8")) if path.is_file() else {}
            known = {key: record.get(key) for key in shown} | {"contrasts": record.get("contrasts")}
            found.append({**known, "row": name, "task": task.name, "made": name in rows()})
    return found


def _contrast_table(figures: ContrastFigures) -> pl.DataFrame:
    lines = []
    for figure in figures.contrasts:
        low, high = figure.difference.mean_ci or (None, None)
        lines.append(
            {
                "task": figure.task,
                "method": figure.method,
                "baseline": figure.baseline,
                "metric": figure.metric,
                "named": figure.named,
                "seeds": min(figure.seeds),
                "partners": figure.partners,
                "mean": figure.difference.mean,
                "low": low,
                "high": high,
                "p": figure.p,
                "p_holm": figure.p_holm,
                "found": figure.found,
                "detectable": figure.detectable,
                "detectable_holm": figure.detectable_holm,
            }
        )
    return pl.DataFrame(lines, infer_schema_length=None)
