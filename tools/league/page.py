"""The tables and figures of a league's page, from folders of rows."""

import json
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from assistax_base.bounded_reading import parse_json
from assistax_base.files import atomic_write
from assistax_zoo.comparing import compare_named
from evaluation.figures.contrasts import ContrastFigures
from evaluation.figures.league import league_table, ordered, read_league, row_folders
from evaluation.plots.league import failure_chart, failures, league_chart, validation_curves
from evaluation.plots.style import save_figure
from evaluation.record import tables
from evaluation.validation import CURVE
from tools.league.making import RECORD, RUNS
from tools.league.rows import rows


def write_tables(
    folder: Path, out: Path, images: Path, contrasts: Path | None = None
) -> list[Path]:
    """Write CSV tables and figures of every task of a folder, and return their paths.

    Of each task: `TASK-league.csv`, `TASK-partners.csv` (who fails with whom), and
    `TASK-validation.csv`; of all tasks: `rows.csv` (steps and device minutes) and, with a file of
    contrasts, `contrasts.csv`. Figures have the names of their tables.

    Args:
        folder: Has a folder for each task, with one for each row, as `row` fills it.
        out: Of the tables.
        images: Of the figures.
        contrasts: File of named contrasts.

    Raises:
        FileNotFoundError: The folder has no row of any task.
    """
    tasks = sorted(place for place in folder.glob("*") if row_folders(place))
    if not tasks:
        raise FileNotFoundError(f"{folder} has no folder of a task with rows; make some with `row`")
    written = []
    for task in tasks:
        written += _task(task, out, images)
    written.append(_csv(pl.DataFrame(_records(tasks)), out / "rows.csv"))
    if contrasts is not None:
        all_rows = [place for task in tasks for place in row_folders(task).values()]
        figures = compare_named(contrasts, all_rows)
        written.append(_csv(_contrast_table(figures), out / "contrasts.csv"))
        about = {"file": figures.file, "sha256": figures.sha256, "notes": list(figures.notes)}
        path = out / "contrasts.json"
        atomic_write(path, (json.dumps(about, indent=1) + "\n").encode())
        written.append(path)
    return written


def _task(task: Path, out: Path, images: Path) -> list[Path]:
    league = read_league(task)
    table, shares = league_table(league), failures(league.by_partner)
    name = league.context.task
    written = [
        _csv(table, out / f"{name}-league.csv"),
        _csv(shares, out / f"{name}-partners.csv"),
        *_figure(league_chart(table, name), images / f"{name}-league.png"),
        *_figure(failure_chart(shares, name), images / f"{name}-partners.png"),
    ]
    curves = {
        row: tables.read_parquet(path)
        for row in ordered(place.name for place in (task / RUNS).glob("*"))
        if (path := task / RUNS / row / "training" / CURVE).is_file()
    }
    if curves:
        long = pl.concat(
            curve.select(pl.lit(row).alias("row"), pl.all()) for row, curve in curves.items()
        )
        written.append(_csv(long, out / f"{name}-validation.csv"))
        drawn = validation_curves(curves, name)
        written += _figure(drawn, images / f"{name}-validation.png")
    return written


def _figure(figure: Figure, path: Path) -> list[Path]:
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path)
    return [path]


def _csv(table: pl.DataFrame, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, table.write_csv(float_precision=4).encode())
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
