"""Compute a folder's tables and figures again from its episodes, and compare them.

They are computed by the usual functions in a temporary folder. Numbers may differ in the sixth
digit, as sums on another processor do.
"""

import dataclasses
import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from evaluation.cast.met_partners import MetPartners
from evaluation.figures.normalised import COLUMN, CROSS_PLAY, bounds_table
from evaluation.figures.saved_tables import save_crossplay, save_evaluation
from evaluation.figures.summary import Context
from evaluation.play.evaluator import in_order
from evaluation.play.jobs import Job
from evaluation.play.rows import planned_rows
from evaluation.play.tiles import Tile
from evaluation.record import tables
from evaluation.record.columns import validate_episodes
from evaluation.record.record import Record
from evaluation.replay.metrics import ReceivedMetrics

RELATIVE, ABSOLUTE = 1e-6, 1e-9
LOOSE = 1e-3  # for strategies: a determinant depends on the smallest eigenvalue


def planned_table(job: Job, tiles: Sequence[Tile]) -> pl.DataFrame:
    """Return the columns of a job's episode table that are known before playing, in its order."""
    return in_order(pl.concat([planned_rows(job, tile) for tile in tiles]), job)


def planned_problems(kept: pl.DataFrame, planned: pl.DataFrame, name: str) -> list[str]:
    """Return the problem of a kept table whose planned columns differ from the job's, if any."""
    if kept.height != planned.height:
        return [f"{name} has {kept.height} episodes; the job has {planned.height}"]
    differing = [
        column
        for column in planned.columns
        if column not in kept.columns
        or not kept[column].cast(planned.schema[column], strict=False).equals(planned[column])
    ]
    return [f"{name} has another {', '.join(differing)} than the job"] if differing else []


def derived_problems(
    record: Record,
    context: Context,
    met: MetPartners,
    *,
    is_crossplay: bool,
    references: pl.DataFrame | None,
    crossplay: pl.DataFrame | None,
    notes: Sequence[str] = (),
    metrics: ReceivedMetrics,
) -> list[str]:
    """Return problems of files that differ from those computed from the folder's episodes.

    Args:
        record: The record of a verified folder.
        context: The run's metadata, from the registry and the job.
        met: The robots' training partners.
        is_crossplay: Whether the folder is a cross-play.
        references: The reference egos' episodes, if the folder has them.
        crossplay: Pairs of the cross-play whose robots may be best responses.
        notes: The summary's notes on robots from outside.
        metrics: Metrics of packages that the folder names.
    """
    with tempfile.TemporaryDirectory() as name:
        fresh = dataclasses.replace(record, folder=Path(name))
        if is_crossplay:
            save_crossplay(fresh, context, met, metrics.installed)
            return list(_file_problems(record.folder, fresh.folder, metrics))
        drawn = None if references is None else (references, bounds_table(references, crossplay))
        problems: list[str] = []
        # Either choice may have been made.
        for include_own in (False, True):
            options = {"include_own": include_own, "references": drawn, "met": met, "notes": notes}
            options["metrics"] = metrics.installed
            try:
                save_evaluation(fresh, context, **options)
            except ValueError as error:
                # All partners are the robots' own.
                problems = problems or [str(error)]
                continue
            differing = list(_file_problems(record.folder, fresh.folder, metrics))
            if not differing:
                return []
            problems = problems or differing
        return problems


def check_crossplay(folder: Path, crossplay: pl.DataFrame | None) -> None:
    """Check that a cross-play is given if the folder's bounds depend on one.

    Raises:
        ValueError: The cross-play is missing.
    """
    path = folder / tables.BOUNDS_FILE
    if crossplay is None and path.is_file():
        bounds = tables.read_parquet(path)
        if "source" in bounds.columns and CROSS_PLAY in bounds["source"].to_list():
            raise ValueError(
                f"best responses of {folder} are of a cross-play; give its folder as well"
            )


def read_references(folder: Path) -> pl.DataFrame | None:
    """Return the reference egos' episodes of a folder, or None if it has none.

    Raises:
        ValueError: The table is malformed.
    """
    path = folder / tables.REFERENCES_FILE
    if not path.is_file():
        return None
    table = tables.read_parquet(path)
    if COLUMN not in table.columns:
        raise ValueError(f"{path} has no column {COLUMN}")
    validate_episodes(table.drop(COLUMN))
    return table


def _file_problems(folder: Path, fresh: Path, metrics: ReceivedMetrics) -> Iterator[str]:
    """Yield a problem for each file that is missing, unexpected or different in the folder."""
    drawn = {path.name for path in fresh.iterdir()}
    apart = {tables.EPISODES_FILE, tables.RUN_FILE, tables.MATRIX_FIGURE}
    kept = {name for name in tables.FILES if (folder / name).is_file()} - apart
    for name in sorted(drawn ^ kept):
        yield f"{folder / name} {'is missing' if name in drawn else 'is none of this job'}"
    for name in sorted(drawn & kept):
        loose = LOOSE if name == tables.STRATEGIES_FILE else RELATIVE
        read = _read_table if name.endswith(".parquet") else tables.read_json
        old, new = read(folder / name), read(fresh / name)
        old = metrics.without_figures(old) if name == tables.SUMMARY_FILE else old
        if place := next(_differences(old, new, loose), None):
            yield f"{folder / name} is not what its episodes give: {place}"


def _read_table(path: Path) -> dict[str, Any]:
    table = tables.read_parquet(path)
    kinds = [f"{name} {kind}" for name, kind in table.schema.items()]
    return {"columns": kinds, **table.to_dict(as_series=False)}


def _differences(kept: Any, fresh: Any, relative: float, place: str = "") -> Iterator[str]:
    """Yield a text for each place where two JSON values differ."""
    if isinstance(kept, dict) and isinstance(fresh, dict) and kept.keys() == fresh.keys():
        for name in fresh:
            yield from _differences(kept[name], fresh[name], relative, f"{place}.{name}")
    elif isinstance(kept, list) and isinstance(fresh, list) and len(kept) == len(fresh):
        for row, (old, new) in enumerate(zip(kept, fresh, strict=True)):
            yield from _differences(old, new, relative, f"{place}[{row}]")
    elif isinstance(kept, float) and isinstance(fresh, float):
        if not math.isclose(kept, fresh, rel_tol=relative, abs_tol=ABSOLUTE):
            yield f"{place.strip('.')} is {kept}, and {fresh} is true of them"
    elif type(kept) is not type(fresh) or kept != fresh:
        yield f"{place.strip('.')} is {str(kept)[:60]!r}, and {str(fresh)[:60]!r} is true of them"
