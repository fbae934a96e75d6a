"""Draws docs/images/curves_gentle.png: how teams of the gentle tasks learn, as `tools.gates` does.

    python -m tools.gate_curves runs --out docs/images/curves_gentle.png

RUNS/TASK/CONDITION are folders that `tools.gates` filled; conditions that are absent are left out.
"""

from pathlib import Path

import polars as pl
from cyclopts import App
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter

from assistax_envs.models import build_model
from assistax_envs.tasks import TASK_CLASSES
from assistax_envs.versions import GENTLE_TASKS
from evaluation import tables
from evaluation.curves import learning_curves
from evaluation.plots import style

CONDITIONS = ("teams", "mappo", "masac")
COLUMNS = ("return of an episode", "steps with a contact above 65 N", "cost of force")
WIDTH, ROW = 10.0, 2.3  # inches


def main(runs: Path, /, *, out: Path) -> None:
    """Draw return, violations and the cost of force against steps, by task and algorithm."""
    caption = (
        "Mean over seeds (IQM) with its pointwise 95% bootstrap band; actions are drawn, as in "
        "training. Eight seeds, of MAPPO in gentle lift four."
    )
    height = ROW * len(GENTLE_TASKS) + 0.8
    figure = style.titled_figure("Training of the gentle tasks, d1", caption, WIDTH, height)
    grid = figure.subplots(len(GENTLE_TASKS), len(COLUMNS), squeeze=False)
    figure.subplots_adjust(0.08, 0.6 / height, 0.98, 1 - 0.6 / height, 0.28, 0.45)
    for task, row in zip(GENTLE_TASKS, grid, strict=True):
        weight = TASK_CLASSES[task](build_model(task)).weights["violation"]
        for condition in CONDITIONS:
            if (folder := runs / task / condition).is_dir():
                _draw(list(row), folder, weight)
        row[0].set_title(task, fontsize=9, loc="left", weight="bold")
        row[0].legend(fontsize=7, frameon=False)
    style.save_figure(figure, out, dpi=110)


def _draw(row: list[Axes], folder: Path, weight: float) -> None:
    algorithm = tables.read_json(folder / "config.json")["config"]["algorithm"]
    colour = style.algorithm_colours([algorithm])[algorithm]
    metrics = tables.read_parquet(folder / "metrics.parquet")
    drawn = (pl.col("return"), -pl.col("term_violation") / weight, -pl.col("term_force"))
    for axes, values, label in zip(row, drawn, COLUMNS, strict=True):
        curve = learning_curves(metrics.with_columns(values.alias("return")))
        style.band(axes, curve, "steps", "iqm", colour, algorithm.upper())
        axes.set_ylabel(label, fontsize=8)
        axes.tick_params(labelsize=7)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        style.bare(axes, ("left", "bottom"))


if __name__ == "__main__":
    App(default_command=main)()
