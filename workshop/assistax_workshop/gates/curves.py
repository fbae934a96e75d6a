"""Draws docs/images/curves_gentle.png: how the teams of the gentle tasks learned, with d1."""

from pathlib import Path

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter

from assistax_envs.versions import GENTLE_TASKS
from evaluation.figures.metrics.curves import learning_curves
from evaluation.plots import style
from evaluation.record import tables

ALGORITHMS = ("ippo", "mappo", "mep", "masac")
SETTING = "d1"
COLUMNS = {  # heading -> what is drawn
    "return of an episode": pl.col("return"),
    "goal reached,\nshare of episodes": pl.col("success"),
    "a contact above 65 N,\nshare of episodes": pl.col("violated"),
    "cost of force": -pl.col("term_force"),
}
WIDTH, ROW = 9.0, 2.1  # inches: letters are read in the 700 pixels of a page
LINES = dict(zip(ALGORITHMS, ("-", "--", ":", "-."), strict=True))  # told apart in grey too


@style.own_style()
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
    height = ROW * len(COLUMNS) + 1.0
    title = f"Training of the gentle tasks, {SETTING}"
    figure = style.titled_figure(title, caption, WIDTH, height)
    grid = figure.subplots(len(COLUMNS), len(GENTLE_TASKS), squeeze=False)
    figure.subplots_adjust(0.08, 0.85 / height, 0.93, 1 - 0.7 / height, 0.45, 0.3)
    for task, column in zip(GENTLE_TASKS, grid.T, strict=True):
        for algorithm in ALGORITHMS:
            path = curves / f"{task.replace('_', '-')}-{algorithm}.parquet"
            if path.is_file():
                _draw(list(column), tables.read_parquet(path), algorithm)
        column[0].set_title(task, fontsize=10, weight="bold")
        column[-1].set_xlabel("environment steps of one member", fontsize=9)
        for axes in column:
            _fit(axes)
            ends = {str(line.get_label()): _end(line) for line in axes.lines}
            colours = {str(line.get_label()): str(line.get_color()) for line in axes.lines}
            style.label_ends(axes, ends, colours)
    for axes, heading in zip(grid[:, 0], COLUMNS, strict=True):
        axes.set_ylabel(heading, fontsize=9)
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
        axes.lines[-1].set(linestyle=LINES[algorithm])
        axes.tick_params(labelsize=8)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        style.bare(axes, ("left", "bottom"))


def _fit(axes: Axes) -> None:
    """Show the lines, and of the bands what lies near them: one bad episode reaches far."""
    if axes.lines:
        values = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.lines])
        low, high = np.nanmin(values), np.nanmax(values)
        margin = 0.1 * (high - low) or 0.1
        axes.set_ylim(low - margin, high + margin)
