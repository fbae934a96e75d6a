"""Figure of persons: outcomes over two of their numbers, and the numbers that matter most."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evaluation.plots import style

_WORDS = {"return": "mean return", "success": "success"}
# Inches: letters can be read at the width of a page.
_WIDTH, _HEIGHT = 7.0, 6.6
# Points.
_SIZE = 8


def described_panels(summary: Mapping[str, Any]) -> Figure:
    """Draw `person_panels` with a caption that explains them."""
    caption = (
        f"Robots: {summary['egos']}; episodes: {summary['episodes']}. Cells: means over persons, "
        f"in {summary['bins']} bins of equal counts of each number. Bars: omega squared of the "
        "bins, 95% basic bootstrap over persons; + where the outcome rises with the number; "
        "dotted: what chance reaches with the largest of all."
    )
    return person_panels(summary, caption=caption)


@style.own_style()
def person_panels(summary: Mapping[str, Any], *, caption: str) -> Figure:
    """Draw a summary of `evaluation.figures.by_parameter.summarise_parameters`.

    There is a column for the return and one for success. Above are means in cells of two
    numbers, with the count of persons. Below is each number's share of the variance, with 95%
    intervals.
    """
    title = f"{summary['task']}: {summary['persons']} persons by their numbers"
    figure = style.titled_figure(title, caption, _WIDTH, _HEIGHT)
    grid = figure.add_gridspec(
        2,
        len(summary["matter"]),
        left=0.2,
        right=0.97,
        top=0.89,
        bottom=0.18,
        wspace=0.65,
        hspace=0.34,
        height_ratios=(3, 2),
    )
    for column, (outcome, matter) in enumerate(summary["matter"].items()):
        _surface(figure.add_subplot(grid[0, column]), summary["surface"], outcome)
        _bars(figure.add_subplot(grid[1, column]), matter, outcome)
    return figure


def _surface(axes: Axes, surface: Mapping[str, Any], outcome: str) -> None:
    """Draw the means in cells: x from left to right, y upwards."""
    means = np.array(surface["values"][outcome], float).T  # None becomes NaN
    counts = np.array(surface["count"]).T
    style.bare(axes)
    colours = matplotlib.colormaps[style.COLOUR_MAP]
    low, high = np.nanmin(means), np.nanmax(means)
    drawn = axes.imshow(means, origin="lower", cmap=colours, aspect="auto", vmin=low, vmax=high)
    digits = 0 if outcome == "return" else 2
    for (row, column), value in np.ndenumerate(means):
        if counts[row, column]:
            ink = style.ink_on(tuple(drawn.to_rgba(value)))
            text = f"{value:.{digits}f}\nn {counts[row, column]}"
            axes.text(column, row, text, ha="center", va="center", fontsize=_SIZE, color=ink)
    for name, ticks in (("x", axes.set_xticks), ("y", axes.set_yticks)):
        edges = surface[f"{name}_edges"]
        ticks(np.arange(len(edges)) - 0.5, [f"{edge:.2g}" for edge in edges], fontsize=_SIZE)
    axes.set_xlabel(surface["x"], fontsize=_SIZE)
    axes.set_ylabel(surface["y"], fontsize=_SIZE)
    axes.set_title(_WORDS[outcome], fontsize=_SIZE + 1, loc="left", color=style.INK)


def _bars(axes: Axes, matter: Mapping[str, Any], outcome: str) -> None:
    """Draw the share of variance of each number, the largest on top, and the chance level."""
    effects = matter["parameters"]
    places = -np.arange(len(effects))
    shares = np.array([effect["share"] for effect in effects])
    ends = np.array([effect["share_ci"] for effect in effects])
    style.bare(axes, ("left", "bottom"))
    axes.barh(places, np.maximum(shares, 0.0), height=0.55, color=style.ALGORITHMS["ippo"])
    axes.hlines(places, np.maximum(ends[:, 0], 0.0), np.maximum(ends[:, 1], 0.0), color=style.INK)
    axes.axvline(matter["chance"], color=style.MUTED, linewidth=0.8, linestyle=":")
    names = [f"{e['parameter']} {'+' if e['low_to_high'] > 0 else '-'}" for e in effects]
    axes.set_yticks(places, names, fontsize=_SIZE)
    axes.tick_params(axis="x", labelsize=_SIZE)
    axes.set_xlim(0.0, max(0.05, float(ends.max()) * 1.05))
    axes.set_xlabel(f"share of the variance of {_WORDS[outcome]}", fontsize=_SIZE)
