"""Figure of a league: the returns of its rows."""

from collections.abc import Mapping

import polars as pl
from matplotlib.figure import Figure

from evaluation.figures.league import FIRST, LAST
from evaluation.plots import style


@style.own_style()
def league_chart(tables: Mapping[str, pl.DataFrame]) -> Figure:
    """Draw the mean of each row with its 95% interval, the first row on top, a panel for each task.

    Args:
        tables: Tables of `evaluation.figures.league.league_table`, by task.
    """
    each = 0.9 + 0.28 * max(table.height for table in tables.values())
    caption = "Mean, 95% interval. Squares: methods that are compared with PPO."
    figure, panels = panels_of("League", caption, tables, each, left=0.26 * 6.4)
    for (left, bottom, width, tall), (task, table) in zip(panels, tables.items(), strict=True):
        axes = figure.add_axes((left, bottom, width, tall))
        for place, row in enumerate(table.iter_rows(named=True)):
            fixed = row["row"] in (*FIRST, *LAST)
            colour = style.MUTED if fixed else style.ALGORITHMS["ippo"]
            if row["low"] is not None:
                axes.plot([row["low"], row["high"]], [place, place], color=colour, linewidth=1.6)
            axes.plot([row["mean"]], [place], "o" if fixed else "s", color=colour, markersize=5)
        axes.set_yticks(range(table.height), table["row"].to_list(), fontsize=8)
        axes.invert_yaxis()
        axes.set_xlabel(f"{task}: return of an episode", fontsize=9)
        axes.tick_params(axis="x", labelsize=8)
        axes.grid(axis="x", color=style.GRID, linewidth=0.6)
        axes.set_axisbelow(True)
    return figure


def panels_of(
    title: str,
    caption: str,
    tasks: Mapping[str, object],
    each: float,
    *,
    left: float,
    right: float = 0.15,
) -> tuple[Figure, list[tuple[float, float, float, float]]]:
    """Return a figure and the places of the tasks' panels in it, two side by side.

    Sizes in inches: `each` is the height of a panel with its labels, `left` is before each panel,
    and `right` beside all.
    """
    columns = min(2, len(tasks))
    lines = -(-len(tasks) // columns)
    whole, tall = 6.4 if columns == 1 else 8.8, 0.9 + lines * each
    what = f"{title}: {', '.join(tasks)}" if len(tasks) <= 2 else f"{title}, {len(tasks)} tasks"
    figure = style.titled_figure(what, caption, whole, tall)
    wide = (whole - right) / columns
    size = (wide - left - 0.15) / whole, (each - 0.65) / tall
    corners = (divmod(place, columns) for place in range(len(tasks)))
    return figure, [
        ((column * wide + left) / whole, (tall - 0.05 - (line + 1) * each) / tall, *size)
        for line, column in corners
    ]
