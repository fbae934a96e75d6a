"""Draws docs/images/curves_gentle.png: how the teams of the gentle tasks learned, with d1."""

from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter

from assistax_envs.versions import GENTLE_TASKS
from evaluation.figures.curves import learning_curves
from evaluation.plots import style
from evaluation.record import tables

ALGORITHMS = ("ippo", "mappo", "mep", "masac")
SETTING = "d1"
COLUMNS = {  # heading -> what is drawn
    "return of an episode": pl.col("return"),
    "goal reached, share of episodes": pl.col("success"),
    "a contact above 65 N, share of episodes": pl.col("violated"),
    "cost of force": -pl.col("term_force"),
}
WIDTH, ROW = 13.0, 2.3  # inches


def draw_curves(curves: Path, out: Path) -> None:
    """Draw return, success, violations and the cost of force against steps, by task.

    Algorithms that the folder lacks are left out, as are groups that trained for fewer steps to be
    compared.

    Args:
        curves: Folder of a population's curves.
        out: Picture to write.
    """
    caption = (
        "Mean over seeds (IQM) with its pointwise 95% bootstrap band; actions are drawn, as in "
        "training. Bands end where the picture does."
    )
    height = ROW * len(GENTLE_TASKS) + 1.0
    title = f"Training of the gentle tasks, {SETTING}"
    figure = style.titled_figure(title, caption, WIDTH, height)
    grid = figure.subplots(len(GENTLE_TASKS), len(COLUMNS), squeeze=False)
    figure.subplots_adjust(0.06, 0.8 / height, 0.955, 1 - 0.7 / height, 0.45, 0.5)
    for task, row in zip(GENTLE_TASKS, grid, strict=True):
        for algorithm in ALGORITHMS:
            path = curves / f"{task.replace('_', '-')}-{algorithm}.parquet"
            if path.is_file():
                _draw(list(row), tables.read_parquet(path), algorithm)
        for axes, heading in zip(row, COLUMNS, strict=True):
            axes.set_title(heading, fontsize=9)
            _fit(axes)
        row[0].set_ylabel(task, fontsize=9, weight="bold")
        for axes in row:
            ends = {str(line.get_label()): _end(line) for line in axes.lines}
            colours = {str(line.get_label()): str(line.get_color()) for line in axes.lines}
            style.label_ends(axes, ends, colours)
    for axes in grid[-1]:
        axes.set_xlabel("environment steps of one member", fontsize=8)
    style.save_figure(figure, out, dpi=110)


def _end(line: Line2D) -> tuple[float, float]:
    x, y = np.asarray(line.get_xydata(), float)[-1]
    return float(x), float(y)


def _draw(row: list[Axes], table: pl.DataFrame, algorithm: str) -> None:
    colour = style.algorithm_colours([algorithm])[algorithm]
    own = table.filter(pl.col("disability") == SETTING)
    for axes, values in zip(row, COLUMNS.values(), strict=True):
        curve = learning_curves(own.with_columns(values.alias("return")))
        style.band(axes, curve, "steps", "iqm", colour, style.spelled(algorithm))
        axes.tick_params(labelsize=7)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        style.bare(axes, ("left", "bottom"))


def _fit(axes: Axes) -> None:
    """Show the lines, and of the bands what lies near them: one bad episode reaches far."""
    if axes.lines:
        values = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
        low, high = np.nanmin(values), np.nanmax(values)
        margin = 0.1 * (high - low) or 0.1
        axes.set_ylim(low - margin, high + margin)
