"""Figure of adaptation: what robots did beside what persons like."""

from collections.abc import Mapping

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from evaluation.figures.metrics.adaptation import CREDITED, Adaptation
from evaluation.plots import style

# Of each wish: the factor to the unit that is shown, and the unit.
UNITS = {
    "force": (1.0, "N"),
    "press": (1.0, "N"),
    "speed": (100.0, "cm/s"),
    "distance": (100.0, "cm"),
    "place": (100.0, "cm"),
    "wait": (100.0, "cm"),
    "depth": (1000.0, "mm"),
}
_WIDTH = 3.6  # inches of a panel
_LEAST = 2.6
_SIZE = 8  # points


@style.own_style()
def adaptation_panels(
    persons: pl.DataFrame,
    found: Mapping[str, Adaptation],
    *,
    title: str,
    caption: str,
    width: float | None = None,
) -> Figure:
    """Draw done against liked, a panel for each wish and a point for each person, on log axes.

    Args:
        persons: A table of `evaluation.figures.metrics.caring.persons_done`.
        found: The adaptation to each wish for which it is defined.
        title: The figure's title.
        caption: What is written below it, before the explanation.
        width: Inches of the figure.
    """
    wishes = persons["wish"].unique(maintain_order=True).to_list()
    style.check_width(width, _LEAST)
    whole = width or _WIDTH * len(wishes) + 0.3
    text = (
        f"{caption}\nA point is a person: geometric means over robots and episodes, in seconds 10 "
        f"to 20. Filled: {CREDITED:.0%} of the touch and more is within a factor 1.5 of what is "
        "liked, the grey band. Solid: the adaptation slope; dotted: one that does not count."
    )
    foot = style.caption_height(text, whole) + 0.6
    tall = 0.5 + 0.85 * whole / len(wishes) + foot
    figure = style.titled_figure(title, text, whole, tall)
    grid = figure.add_gridspec(
        1, len(wishes), left=0.62 / whole, right=1 - 0.1 / whole, top=1 - 0.62 / tall,
        bottom=foot / tall, wspace=0.35,
    )  # fmt: skip
    for place, wish in enumerate(wishes):
        mine = persons.filter(pl.col("wish") == wish)
        _panel(figure.add_subplot(grid[0, place]), wish, mine, found.get(wish))
    return figure


def _panel(axes: Axes, wish: str, persons: pl.DataFrame, found: Adaptation | None) -> None:
    factor, unit = UNITS[wish]
    liked, done = (factor * persons[name].to_numpy() for name in ("liked", "done"))
    ends = min(liked.min(), done.min()) / 1.15, max(liked.max(), done.max()) * 1.15
    diagonal = np.array(ends)
    axes.fill_between(diagonal, diagonal / 1.5, diagonal * 1.5, color=style.GRID, linewidth=0)
    axes.plot(diagonal, diagonal, color=style.MUTED, linewidth=0.8)
    near, colour = persons["within"].to_numpy() >= CREDITED, style.ALGORITHMS["ippo"]
    axes.scatter(liked[near], done[near], s=9, color=colour, linewidth=0)
    axes.scatter(liked[~near], done[~near], s=9, facecolor="none", edgecolor=colour, linewidth=0.6)
    if found is not None and found.plain is not None:
        _line(axes, liked, done, found)
    axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.tick_params(labelsize=_SIZE)
    axes.set_xlabel(f"liked {wish}, {unit}", fontsize=_SIZE)
    axes.set_ylabel(f"done, {unit}", fontsize=_SIZE)
    axes.set_title(_said(wish, found), fontsize=_SIZE + 1, loc="left", color=style.INK)


def _line(axes: Axes, liked: np.ndarray, done: np.ndarray, found: Adaptation) -> None:
    """Draw the slope through the mean of the points."""
    x, y = np.log(liked).mean(), np.log(done).mean()
    span = np.log([liked.min(), liked.max()])
    line = "-" if found.credited else ":"
    rise = y + (found.plain or 0.0) * (span - x)
    axes.plot(np.exp(span), np.exp(rise), line, color=style.INK, linewidth=1.6)


def _said(wish: str, found: Adaptation | None) -> str:
    """Return the title of a panel: the wish and its slope."""
    if found is None:
        return wish
    ends = found.slope.value_ci
    interval = " [{:.2f}, {:.2f}]".format(*ends) if ends else ""
    return f"{wish}: slope {found.slope.value:.2f}{interval}"
