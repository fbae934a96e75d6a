"""Texts around a cross-play heatmap: legend, headline and caption."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle
from matplotlib.textpath import text_to_path

from assistax_base.errors import counted
from evaluation.plots import style
from evaluation.plots.crossplay.matrix import Matrix
from evaluation.plots.crossplay.traits import Trait

_LINE, _PATCH, _SPACE = 1.4, 1.6, 1.1  # times the letters' size: line, patch with gap, gap of items
_OUTSIDE = "from outside the zoo"


@dataclasses.dataclass(frozen=True)
class Item:
    """A text of a legend at a place in inches, right and down from the legend's corner."""

    text: str
    colour: str | None  # of the patch before the text
    heading: bool
    x: float = 0.0
    y: float = 0.0


@dataclasses.dataclass(frozen=True)
class Legend:
    """A legend's items, and its size in inches."""

    items: tuple[Item, ...]
    width: float
    height: float


def legend_blocks(matrix: Matrix, traits: Sequence[Trait]) -> list[list[Item]]:
    """Return the legend's blocks, each with its heading first: algorithms, levels, clusters."""
    blocks = []
    for trait in reversed(traits):
        items = [Item(text, colour, False) for text, colour in trait.colours.items()]
        blocks.append([Item(trait.name, None, True), *items])
    if None in (*matrix.rows.algorithms, *matrix.columns.algorithms):
        blocks[0].append(Item(_OUTSIDE, style.UNKNOWN, False))
    sides = (
        [("teams", matrix.rows)]
        if matrix.shared
        else [("robots", matrix.rows), ("humans", matrix.columns)]
    )
    for what, side in sides:
        if side.silhouette is None:
            continue
        texts = [f"{c.letter}  n = {c.stop - c.start}, medoid {c.medoid}" for c in side.clusters]
        if len(texts) == 1:
            texts = ["none clear, all are one"]
        head = Item(f"clusters of {what} (silhouette {side.silhouette:.2f})", None, True)
        blocks.append([head, *(Item(text, None, False) for text in texts)])
    return blocks


def stacked(blocks: Sequence[Sequence[Item]], letters: float) -> Legend:
    """Return a legend for the side of a matrix: an item a line, with letters of so many points."""
    line, y, placed = _LINE * letters / 72, 0.0, []
    for block in blocks:
        for item in block:
            placed.append(dataclasses.replace(item, y=y + line / 2))
            y += line
        y += line / 2
    widest = max(_width(item, letters) for item in placed)
    return Legend(tuple(placed), widest, y - line / 2)


def flowed(blocks: Sequence[Sequence[Item]], letters: float, width: float) -> Legend:
    """Return a legend of a width in inches, for below a matrix: items follow each other in lines.

    A block that fits into the rest of a line stands there; otherwise it begins a line.
    """
    line, space = _LINE * letters / 72, _SPACE * letters / 72
    x, y, placed = 0.0, line / 2, []
    for block in blocks:
        whole = sum(_width(item, letters) + space for item in block)
        if x and x + space + whole > width:
            x, y = 0.0, y + line
        x += space if x else 0.0
        for item in block:
            wide = _width(item, letters)
            if x and x + wide > width:
                x, y = 0.0, y + line
            placed.append(dataclasses.replace(item, x=x, y=y))
            x += wide + space
    return Legend(tuple(placed), width, y + line / 2)


@functools.lru_cache(4096)
def text_width(text: str, points: float, *, bold: bool = False) -> float:
    """Return the width in inches of a text of a size in points."""
    font = FontProperties(size=points, weight="bold" if bold else "normal")
    return text_to_path.get_text_width_height_descent(text, font, ismath=False)[0] / 72


def draw_legend(axes: Axes, legend: Legend, letters: float) -> None:
    """Draw a legend into axes of its size, with letters of a size in points."""
    axes.set_axis_off()
    axes.set(xlim=(0, legend.width), ylim=(legend.height, 0))  # both in inches
    em = letters / 72
    for item in legend.items:
        x = item.x
        if item.colour is not None:
            corner = (x, item.y - 0.45 * em)
            axes.add_patch(
                Rectangle(corner, 1.2 * em, 0.9 * em, facecolor=item.colour, linewidth=0)
            )
            x += _PATCH * em
        font = {"fontsize": letters, "weight": "bold" if item.heading else "normal"}
        axes.text(x, item.y, item.text, va="center", color=style.INK, fontdict=font)


def _width(item: Item, letters: float) -> float:
    patch = _PATCH * letters / 72 if item.colour is not None else 0.0
    return patch + text_width(item.text, letters, bold=item.heading)


def headline(summary: Mapping[str, Any]) -> str:
    """Return the text with self-play, cross-play and their gap, with intervals."""
    named = {
        "self-play": summary["self_play"],
        "cross-play": summary["cross_play"],
        "gap": summary["gap"],
    }
    return "mean and 95% interval: " + "; ".join(
        f"{name} {_figure(value)}" for name, value in named.items() if value
    )


def caption(matrix: Matrix, summary: Mapping[str, Any], marked: str) -> str:
    """Return the caption with the task, numbers of policies and episodes, and the order."""
    rows, columns = matrix.values.shape
    split = f", split {summary['split']['id']}" if summary["split"] else ""
    order = (
        "one order of teams, self-play on the diagonal"
        if matrix.shared
        else "each axis in its own order, self-play"
    )
    order = order if marked or matrix.shared else "each axis in its own order"
    ending = "" if not marked else f" and marked {marked}" if matrix.shared else f" marked {marked}"
    return (
        f"n = {counted(rows, 'robot')} × {counted(columns, 'human')}, "
        f"{counted(summary['episodes_per_pair'], 'episode')} a pair "
        f"({summary['episodes']:,} episodes, {summary['nonfinite']} non-finite). Release "
        f"{summary['release']}{split}, environment version {summary['env_version']}, backend "
        f"{summary['backend']}. Average linkage, Euclidean distance, optimal leaf order; "
        f"{order}{ending}."
    )


def _figure(value: Mapping[str, Any]) -> str:
    interval = "" if value["mean_ci"] is None else " [{:z.0f}, {:z.0f}]".format(*value["mean_ci"])
    return f"{value['mean']:z.0f}{interval}"
