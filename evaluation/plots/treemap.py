"""Treemap of a population (paper, Figure 2): areas for algorithms, in them for settings."""

from collections.abc import Sequence

import polars as pl
import squarify
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from evaluation.plots import style

_PANEL, _HEAD, _FOOT = 3.6, 0.75, 0.4  # inches


def population_treemap(teams: pl.DataFrame, *, caption: str) -> Figure:
    """Draw the number of partners by task, algorithm and disability setting.

    Args:
        teams: columns task, algorithm and disability, one row a partner.
        caption: written below.
    """
    if teams.is_empty():
        raise ValueError("the population is empty; there is nothing to draw")
    tasks = teams["task"].unique().sort().to_list()
    width, height = 0.4 + len(tasks) * (_PANEL + 0.2), _HEAD + _PANEL + _FOOT
    figure = style.titled_figure("Population of partners", caption, width, height)
    for i, task in enumerate(tasks):
        corner = ((0.2 + i * (_PANEL + 0.2)) / width, _FOOT / height)
        axes = figure.add_axes((*corner, _PANEL / width, _PANEL / height), label=f"treemap:{task}")
        _draw_task(axes, teams.filter(task=task))
        axes.set_title(
            f"{task}, n = {teams.filter(task=task).height}",
            fontsize=10,
            color=style.INK,
            loc="left",
        )
    return figure


def _draw_task(axes: Axes, teams: pl.DataFrame) -> None:
    axes.set(xlim=(0, 100), ylim=(100, 0))
    axes.set_axis_off()
    colours = style.disability_colours(teams["disability"])
    algorithms = _counts(teams, "algorithm")
    for (algorithm, count), (x, y, dx, dy) in zip(
        algorithms, _areas(algorithms, 0, 0, 100, 100), strict=True
    ):
        head = min(7.0, dy * 0.3)
        axes.text(
            x + 0.8,
            y + head / 2,
            f"{algorithm} ({count})",
            fontsize=8,
            weight="bold",
            va="center",
            color=style.INK,
        )
        settings = sorted(_counts(teams.filter(algorithm=algorithm), "disability"))
        for (setting, n), box in zip(
            settings, _areas(settings, x, y + head, dx, dy - head), strict=True
        ):
            _draw_setting(axes, setting, n, box, colours.get(setting, style.UNKNOWN))


def _draw_setting(axes: Axes, setting: str, count: int, box: Sequence[float], colour: str) -> None:
    x, y, dx, dy = box
    axes.add_patch(Rectangle((x, y), dx, dy, facecolor=colour, edgecolor="white", linewidth=1.2))
    ink = style.ink_on(colour)
    if min(dx, dy) > 6:
        text = f"{setting}\n{count}" if dy > 9 else f"{setting}: {count}"
        axes.text(
            x + dx / 2,
            y + dy / 2,
            text,
            fontsize=7,
            ha="center",
            va="center",
            color=ink,
            linespacing=1.2,
        )


def _counts(teams: pl.DataFrame, column: str) -> list[tuple[str, int]]:
    counted = teams.group_by(column).len().sort(["len", column], descending=[True, False])
    return [(name, int(count)) for name, count in counted.iter_rows()]


def _areas(
    counts: Sequence[tuple[str, int]], x: float, y: float, dx: float, dy: float
) -> list[tuple[float, ...]]:
    """Lay counts out as rectangles (x, y, dx, dy) of proportional area, nearly squares."""
    sizes = squarify.normalize_sizes([count for _, count in counts], dx, dy)
    return [
        (box["x"], box["y"], box["dx"], box["dy"]) for box in squarify.squarify(sizes, x, y, dx, dy)
    ]
