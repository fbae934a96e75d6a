"""A population as a grid: a row for each algorithm, a column for each disability setting."""

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.plots import style

_CELL, _LEAST, _HEIGHT = 0.36, 0.24, 0.3  # inches: width of a cell, its least, and its height
_LEFT, _HEAD, _GAP, _FOOT = 0.75, 0.35, 0.75, 0.4  # the gap holds a task's name and its columns'
_ACROSS = 3  # tasks side by side


@style.own_style()
def population_grid(teams: pl.DataFrame, *, caption: str, width: float | None = None) -> Figure:
    """Draw the number of partners by task, algorithm and disability setting (paper, Figure 2).

    Args:
        teams: Table with columns task, algorithm and disability, one row a partner.
        caption: Text below the figure.
        width: Width of the figure, in inches.
    """
    if teams.is_empty():
        raise ValueError("the population is empty; there is nothing to draw")
    tasks = teams["task"].unique().sort().to_list()
    settings = sorted(set(teams["disability"].drop_nulls()) | set(DISABILITY_SETTINGS))
    algorithms = sorted(set(teams["algorithm"]))
    cells = len(settings) + 1  # with sums
    columns = min(len(tasks), _ACROSS)
    if width is None:
        width = 0.2 + columns * (_LEFT + _CELL * cells)
    least = _LEFT + _LEAST * cells
    style.check_width(width, round(0.2 + least, 1))
    columns = min(columns, int((width - 0.2 + 1e-6) / least))
    rows = -(-len(tasks) // columns)
    panel = (width - 0.2) / columns - _LEFT, _HEIGHT * (len(algorithms) + 1)
    foot = _FOOT + style.caption_height(caption, width) - 0.14
    height = _HEAD + rows * (_GAP + panel[1]) + foot
    figure = style.titled_figure("Population of partners", caption, width, height)
    for i, task in enumerate(tasks):
        left = _LEFT + i % columns * (_LEFT + panel[0])
        bottom = height - _HEAD - (i // columns + 1) * (_GAP + panel[1])
        box = (left / width, bottom / height, panel[0] / width, panel[1] / height)
        axes = figure.add_axes(box, label=f"population:{task}")
        _draw_task(axes, teams.filter(task=task), algorithms, settings)
        axes.set_title(
            f"{task}, n = {teams.filter(task=task).height}",
            fontsize=10,
            color=style.INK,
            loc="left",
            pad=25,
        )
    return figure


def _draw_task(axes: Axes, teams: pl.DataFrame, algorithms: list[str], settings: list[str]) -> None:
    colours = style.disability_colours(settings)
    counts = {
        (algorithm, setting): n
        for algorithm, setting, n in teams.group_by("algorithm", "disability").len().iter_rows()
    }
    for row, algorithm in enumerate(algorithms):
        for column, setting in enumerate(settings):
            count = counts.get((algorithm, setting), 0)
            colour = colours[setting] if count else "#f3f3f3"
            axes.add_patch(Rectangle((column, row), 0.94, 0.92, facecolor=colour, linewidth=0))
            if count:
                _write(axes, column, row, count, style.ink_on(colour))
        _write(axes, len(settings), row, teams.filter(algorithm=algorithm).height, style.INK)
    for column, setting in enumerate(settings):
        _write(axes, column, len(algorithms), teams.filter(disability=setting).height, style.INK)
    axes.set(xlim=(0, len(settings) + 1), ylim=(len(algorithms) + 1, 0))
    style.bare(axes, ticks=False)
    axes.xaxis.tick_top()
    names = [f"{name}\n{_meaning(name)}" for name in settings]
    places = [i + 0.47 for i in range(len(settings) + 1)]
    inches = axes.get_window_extent().width / axes.figure.dpi
    size = min(6.5, 6.5 * inches / (_CELL * len(places)))
    axes.set_xticks(places, [*names, "all"], fontsize=size, linespacing=1.3)
    spelled = [*map(style.spelled, algorithms), "all"]
    axes.set_yticks([i + 0.46 for i in range(len(spelled))], spelled, fontsize=8)
    axes.tick_params(length=0, pad=2, colors=style.INK)


def _write(axes: Axes, column: int, row: int, count: int, ink: str) -> None:
    centre = (column + 0.47, row + 0.46)
    axes.text(*centre, str(count), fontsize=7.5, ha="center", va="center", color=ink)


def _meaning(name: str) -> str:
    setting = DISABILITY_SETTINGS.get(name)
    return f"{setting.elbow_range:g}/{setting.strength:g}" if setting else ""
