"""Figures with a panel for each task: learning curves of several algorithms (paper, Figure 3)."""

from collections.abc import Mapping

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from evaluation.plots import style

_WIDTH, _HEIGHT, _GAP = (
    1.55,
    2.2,
    0.85,
)  # inches of a panel, and between them: names of lines, ticks
_LEFT, _TOP, _BOTTOM = 0.65, 0.65, 0.81


@style.own_style()
def training_panels(
    curves: pl.DataFrame, bounds: Mapping[str, Mapping[str, float]], *, caption: str
) -> Figure:
    """Draw the IQM over seeds with its 95% band: a panel for each task, a line for each algorithm.

    Args:
        curves: columns task, algorithm, steps, iqm, low and high.
        bounds: another source's final return of each algorithm of each task, drawn as a dotted line
            of its colour.
        caption: written below, in as many lines as the width asks for.
    """
    tasks = curves["task"].unique(maintain_order=True).to_list()
    if not tasks:
        raise ValueError("there are no curves to draw; give those of at least one task")
    names = sorted(set(curves["algorithm"]))
    colours = style.algorithm_colours(names)
    width = _LEFT + len(tasks) * (_WIDTH + _GAP)
    bottom = _BOTTOM + style.caption_height(caption, width)
    height = _TOP + _HEIGHT + bottom
    figure = style.titled_figure("Training", caption, width, height, drop=0.12)
    for i, task in enumerate(tasks):
        corner = (_LEFT + i * (_WIDTH + _GAP)) / width, bottom / height
        axes = figure.add_axes((*corner, _WIDTH / width, _HEIGHT / height), label=f"curves:{task}")
        _draw_task(axes, curves.filter(task=task), bounds.get(task, {}), colours)
        axes.set_title(task, fontsize=10, color=style.INK, loc="left")
    figure.axes[0].set_ylabel("return of an episode", fontsize=9)
    return figure


def _draw_task(
    axes: Axes, curves: pl.DataFrame, bounds: Mapping[str, float], colours: Mapping[str, str]
) -> None:
    style.bare(axes, ("left", "bottom"))
    axes.tick_params(labelsize=8)
    axes.grid(color=style.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    ends = {}
    for name in curves["algorithm"].unique(maintain_order=True):
        table = curves.filter(algorithm=name)
        ends[style.spelled(name)] = table["steps"][-1], table["iqm"][-1]
        style.band(axes, table, "steps", "iqm", colours[name], name)
        if name in bounds:
            axes.axhline(bounds[name], color=colours[name], linewidth=0.9, linestyle=":")
    axes.set_xlabel("steps of one member", fontsize=9)
    axes.xaxis.set_major_locator(MaxNLocator(3))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    spelled = {style.spelled(name): colour for name, colour in colours.items()}
    style.label_ends(axes, ends, spelled)
