"""Figure of a hyperparameter sweep: the final return over each hyperparameter."""

import math
from collections.abc import Sequence

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from evaluation.plots import style

NOT_HYPERPARAMETERS = ("configuration", "seed", "final_return", "auc", "diverged")
_SIDE, _LEAST, _COLUMNS = 2.6, 1.8, 3  # inches of a panel, its least width; panels side by side
_DECADES = 1.5  # values that span more than this many powers of ten are drawn on a logarithmic axis


@style.own_style()
def sweep_panels(
    results: pl.DataFrame, *, title: str, caption: str, width: float | None = None
) -> Figure:
    """Draw a panel for each hyperparameter, a point a configuration and seed (Figures 9 to 13).

    The configuration with the best mean final return is marked in every panel.

    Args:
        results: Table with columns configuration, seed, final_return, diverged, and one for each
            hyperparameter.
        title: Text above the figure.
        caption: Text below the figure.
        width: Width of the figure, in inches.

    Raises:
        ValueError: There is nothing to draw.
    """
    names = [name for name in results.columns if name not in NOT_HYPERPARAMETERS]
    finished = results.filter(pl.col("final_return").is_not_null())
    if not names or finished.is_empty():
        raise ValueError(
            "the sweep has no hyperparameter or no final return; run `assistax-zoo sweep` with "
            "more steps"
        )
    means = (
        finished.group_by("configuration")
        .agg(pl.col("final_return").mean())
        .sort("final_return", "configuration")
    )
    best = finished.filter(pl.col("configuration") == means["configuration"][-1])
    columns = min(len(names), _COLUMNS)
    if width is None:
        width = _SIDE * columns + 0.6
    style.check_width(width, _LEAST + 0.6)
    columns = min(columns, int((width - 0.6 + 1e-6) / _LEAST))
    rows = math.ceil(len(names) / columns)
    height = _SIDE * rows + 0.9
    figure = style.titled_figure(title, caption, width, height, drop=0.12, size=11)
    grid = figure.add_gridspec(
        rows,
        columns,
        left=0.65 / width,
        right=1 - 0.15 / width,
        top=1 - 0.5 / height,
        bottom=0.75 / height,
        wspace=0.3,
        hspace=0.5,
    )
    for index, name in enumerate(names):
        axes = figure.add_subplot(grid[index // columns, index % columns])
        _panel(axes, name, finished, best)
        if index % columns == 0:
            axes.set_ylabel("final return of an episode", fontsize=8)
    return figure


def _panel(axes: Axes, name: str, shown: pl.DataFrame, best: pl.DataFrame) -> None:
    style.bare(axes, ("left", "bottom"))
    axes.tick_params(labelsize=7)
    values = shown[name].to_list()
    if shown[name].dtype.is_float():
        if min(values) > 0 and math.log10(max(values) / min(values)) > _DECADES:
            axes.set_xscale("log")
        else:
            axes.xaxis.set_major_locator(MaxNLocator(3))
        places, marked = values, best[name].to_list()
    else:
        levels = sorted(set(map(str, values)), key=lambda level: (len(level), level))
        places, marked = _places(values, levels), _places(best[name].to_list(), levels)
        axes.set_xticks(range(len(levels)), levels)
        axes.set_xlim(-0.6, len(levels) - 0.4)
    axes.scatter(
        places, shown["final_return"], s=9, color=style.ALGORITHMS["ippo"], alpha=0.6, linewidths=0
    )
    axes.scatter(
        marked,
        best["final_return"],
        s=26,
        facecolors="none",
        edgecolors=style.ALGORITHMS["mappo"],
        linewidths=1.2,
    )
    axes.set_xlabel(name, fontsize=8)


def _places(values: Sequence[object], levels: Sequence[str]) -> list[float]:
    return [float(levels.index(str(value))) for value in values]
