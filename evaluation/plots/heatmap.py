"""Clustered cross-play heatmap (paper, Figure 4): dendrograms, strips, clusters, caption."""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from scipy.cluster import hierarchy

from evaluation.plots import style
from evaluation.plots.legend import (
    LINE,
    Line,
    caption,
    draw_legend,
    headline,
    in_columns,
    legend_lines,
)
from evaluation.plots.matrix import Matrix, Side
from evaluation.plots.style import INK

Edge = Literal["left", "top"]

# Inches.
_MATRIX = 6.4  # longer side of the matrix
_STRIP, _GAP = 0.13, 0.035
_BRACKET = 0.17  # strip of cluster letters
_LETTER = 0.09  # least bracket with a letter: letters of smaller clusters would lie on each other
_TREE = 0.42
_LEGEND = 2.75
_BAR = 0.85  # of the colour bar with its figures
_SMALLEST = 1.0  # longer side of a matrix in a narrow figure
_COLOUR_BAR = 1.6
_FEW, _FEW_CELL = 10, 0.2  # an axis with few policies is drawn this wide, whatever the other has
_HEAD = 0.72

_MOST_NAMES = 72  # an axis with more policies shows clusters, not names
_MOST_FIGURES = 14  # a matrix of at most this size shows its numbers
_BELOW = 0.05  # of pairs that may lie below the first colour


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Positions in inches from the top left corner."""

    cells: tuple[float, float]  # height of a row, width of a column
    left: float  # where the matrix begins
    top: float
    width: float  # of the matrix
    height: float
    bar_left: float
    legend: tuple[float, float, float, float]  # left, top, width, height
    columns: list[list[Line]]  # of the legend
    size: tuple[float, float]  # of all, width and height, without the caption


@style.own_style()
def crossplay_heatmap(
    matrix: Matrix, summary: Mapping[str, Any], *, width: float | None = None
) -> Figure:
    """Draw a matrix in its order, with the figures of its summary.

    If the width in inches leaves the matrix small, the legend is below the matrix.
    """
    palettes = {
        "algorithm": style.algorithm_colours([*matrix.rows.algorithms, *matrix.columns.algorithms]),
        "disability": style.disability_colours(
            [*matrix.rows.disabilities, *matrix.columns.disabilities]
        ),
    }
    lines = legend_lines(matrix, palettes["algorithm"], palettes["disability"])
    layout = _layout(matrix, lines) if width is None else _fitted(matrix, lines, width)
    uncoloured = _bad_pairs_note(matrix.values)
    below = caption(matrix, summary, _marks(matrix)) + uncoloured
    wide, high = layout.size[0], layout.size[1] + style.caption_height(below, layout.size[0])
    figure = style.titled_figure(f"Cross-play: {summary['task']}", below, wide, high)
    under: dict[str, Any] = {"va": "top", "color": INK, "gid": style.WORDS}
    # Of 8.5 points, or as large as the figure is wide enough for.
    figure.text(
        0.2 / wide, 1 - 0.42 / high, headline(summary), fontsize=min(8.5, 1.4 * wide), **under
    )

    def place(x: float, y: float, width: float, height: float, label: str) -> Axes:
        corner = (x / wide, 1 - (y + height) / high)
        return figure.add_axes((*corner, width / wide, height / high), label=label)

    heat = place(layout.left, layout.top, layout.width, layout.height, "matrix")
    image = _draw_matrix(heat, matrix, layout.cells)
    _draw_margin(place, layout, "left", matrix.rows, palettes)
    _draw_margin(place, layout, "top", matrix.columns, palettes)
    long = min(_COLOUR_BAR, max(layout.height, _SMALLEST))
    bar = place(layout.bar_left, layout.top, 0.15, long, "colourbar")
    _draw_colour_bar(image, bar, below=bool(uncoloured))
    draw_legend(place(*layout.legend, "legend"), layout.columns)
    return figure


def _fitted(matrix: Matrix, lines: list[Line], width: float) -> _Layout:
    """Return the largest layout of a width, with the legend below if the matrix would be small."""
    least = _layout(matrix, lines, _SMALLEST, below=_SMALLEST).size[0]
    style.check_width(width, math.ceil(10 * least) / 10)
    below = width if _layout(matrix, lines, _MATRIX / 2).size[0] > width else None
    low, high = _SMALLEST, style.WIDEST
    for _ in range(40):
        middle = (low + high) / 2
        fits = _layout(matrix, lines, middle, below).size[0] <= width
        low, high = (middle, high) if fits else (low, middle)
    found = _layout(matrix, lines, low, below)
    return dataclasses.replace(found, size=(width, found.size[1]))


def _layout(
    matrix: Matrix, lines: list[Line], longer: float = _MATRIX, below: float | None = None
) -> _Layout:
    """Return the layout around a matrix whose longer side has a length.

    The legend is on the right, or below in a figure of the width `below`.
    """
    rows, columns = matrix.values.shape
    square = min(longer / max(rows, columns), 0.6)
    cells = [max(square, _FEW_CELL) if count <= _FEW else square for count in (rows, columns)]
    sides = (matrix.rows, matrix.columns)
    # Right of the rows, below the columns.
    rooms = [_name_room(side, _name_size(cell)) for side, cell in zip(sides, cells, strict=True)]
    margins = [_TREE + 2 * (_STRIP + _GAP) + _GAP + _bracket(side) for side in sides]
    left, top = 0.42 + margins[0], _HEAD + margins[1]
    width, height = columns * cells[1], rows * cells[0]
    bar_left, bottom = left + width + rooms[0] + 0.3, top + height + rooms[1] + 0.3
    if below is None:
        dealt, first, across = [lines], top + _COLOUR_BAR + 0.25, _LEGEND
        start, right = bar_left, bar_left + _LEGEND
    else:
        dealt = in_columns(lines, max(1, int((below - 0.4) // _LEGEND)))
        first, across = max(bottom, top + _SMALLEST + 0.2), below - 0.4
        start, right = 0.2, max(bar_left + _BAR, 0.4 + _LEGEND)
    deep = max(LINE, LINE * max(map(len, dealt)))
    size = (right, max(bottom, first + deep) + 0.15)
    place = start, first, across, deep
    return _Layout((cells[0], cells[1]), left, top, width, height, bar_left, place, dealt, size)


def _draw_colour_bar(image: AxesImage, axes: Axes, below: bool) -> None:
    bar = axes.figure.colorbar(image, cax=axes, extend="min" if below else "neither")
    bar.set_label("mean return of an episode", fontsize=8, color=INK)
    axes.tick_params(labelsize=7, width=0.6, length=2.5, colors=INK)
    axes.spines["outline"].set_visible(False)


def _name_size(cell: float) -> float:
    """Return the font size in points of names beside cells of this size in inches."""
    return min(7.5, 0.8 * 72 * cell)


def _name_room(side: Side, size: float) -> float:
    """Return the inches that the policies' names take beside the matrix."""
    return 0.05 + 0.62 * size / 72 * max(map(len, side.names)) if len(side) <= _MOST_NAMES else 0.05


def _draw_matrix(axes: Axes, matrix: Matrix, cells: tuple[float, float]) -> AxesImage:
    values = matrix.values
    norm = Normalize(*_colour_ends(values))
    image = axes.imshow(
        values, cmap=style.COLOUR_MAP, norm=norm, aspect="auto", interpolation="nearest"
    )
    style.bare(axes, ticks=False)
    title = _axis_title("human (partner)", matrix.columns)
    axes.set_xlabel(title, fontsize=9, color=INK, labelpad=4)
    axes.yaxis.tick_right()
    sizes = [_name_size(cell) for cell in cells]
    if len(matrix.columns) <= _MOST_NAMES:
        places = range(len(matrix.columns))
        axes.set_xticks(places, matrix.columns.names, rotation=90, fontsize=sizes[1])
    if len(matrix.rows) <= _MOST_NAMES:
        axes.set_yticks(range(len(matrix.rows)), matrix.rows.names, fontsize=sizes[0])
    axes.tick_params(length=0, pad=2, colors=INK)
    for draw, side in ((axes.axhline, matrix.rows), (axes.axvline, matrix.columns)):
        for cluster in side.clusters[1:]:
            draw(cluster.start - 0.5, color="white", linewidth=1.4)
    if max(values.shape) <= _MOST_FIGURES:
        _write_values(axes, matrix, image)
    elif _marks(matrix):
        _mark_self_play(axes, matrix, image, min(cells))
    return image


def _colour_ends(values: np.ndarray) -> tuple[float, float]:
    """Return the returns of the first and the last colour, without a few very bad pairs.

    In gentle tasks some pairs press on the person for seconds, which costs thousands. A scale that
    includes them would make all other colours alike.
    """
    low, most, high = (float(np.quantile(values, share)) for share in (0.0, _BELOW, 1.0))
    if most - low > high - most:
        low = most
    return low, high if high > low else low + 1.0


def _bad_pairs_note(values: np.ndarray) -> str:
    """Return the caption's sentence on returns below the first colour; empty without any."""
    least = float(values.min())
    if _colour_ends(values)[0] == least:
        return ""
    return f" {_BELOW:.0%} of pairs, down to {least:,.0f}, are below the first colour."


def _marks(matrix: Matrix) -> str:
    """Return the caption's text for the mark of self-play; empty if it is not marked."""
    size = max(matrix.values.shape)
    if not matrix.self_play.any() or (matrix.shared and size > _MOST_NAMES):
        return ""
    return "by bold figures" if size <= _MOST_FIGURES else "by dots"


def _write_values(axes: Axes, matrix: Matrix, image: AxesImage) -> None:
    for (row, column), value in np.ndenumerate(matrix.values):
        own = matrix.self_play[row, column]
        axes.text(
            column,
            row,
            f"{value:z.0f}",
            ha="center",
            va="center",
            color=_contrast(image, value),
            fontsize=7.5 if own else 7,
            weight="bold" if own else "normal",
        )


def _mark_self_play(axes: Axes, matrix: Matrix, image: AxesImage, cell: float) -> None:
    rows, columns = np.nonzero(matrix.self_play)
    colours = [_contrast(image, value) for value in matrix.values[rows, columns]]
    size = max(0.26 * 72 * cell, 1.5)
    axes.scatter(columns, rows, s=size**2, c=colours, linewidths=0, marker="o", label="self-play")


def _contrast(image: AxesImage, value: float) -> str:
    red, green, blue, _ = np.ravel(image.to_rgba(np.array([value]))).tolist()
    return style.ink_on((red, green, blue))


def _draw_margin(
    place: Callable[[float, float, float, float, str], Axes],
    layout: _Layout,
    edge: Edge,
    side: Side,
    palettes: Mapping[str, Mapping[str, str]],
) -> None:
    """Draw, from the matrix outwards: disability, algorithm, clusters, dendrogram."""
    seat = "ego" if edge == "left" else "partner"

    def beside(offset: float, thickness: float, label: str) -> Axes:
        if edge == "left":
            return place(
                layout.left - offset - thickness, layout.top, thickness, layout.height, label
            )
        return place(layout.left, layout.top - offset - thickness, layout.width, thickness, label)

    offset = _GAP
    for trait, values in (("disability", side.disabilities), ("algorithm", side.algorithms)):
        _draw_strip(
            beside(offset, _STRIP, f"strip:{seat}:{trait}"), values, palettes[trait], edge, trait
        )
        offset += _STRIP + _GAP
    if len(side.clusters) > 1:
        _draw_brackets(beside(offset, _BRACKET, f"clusters:{seat}"), side, edge)
    tree = beside(offset + _bracket(side), _TREE, f"tree:{seat}")
    _draw_tree(tree, side, edge)
    if edge == "left":
        tree.set_ylabel(_axis_title("robot (ego)", side), fontsize=9, color=INK, labelpad=4)


def _draw_strip(
    axes: Axes, values: Sequence[str | None], palette: Mapping[str, str], edge: Edge, title: str
) -> None:
    colours = np.array([to_rgb(palette[value] if value else style.UNKNOWN) for value in values])
    strip = colours[:, None] if edge == "left" else colours[None]
    axes.imshow(strip, aspect="auto", interpolation="nearest")
    style.bare(axes, ticks=False)
    if edge == "top":
        axes.text(
            1.01, 0.5, title, transform=axes.transAxes, fontsize=6.5, color=style.FAINT, va="center"
        )


def _draw_brackets(axes: Axes, side: Side, edge: Edge) -> None:
    _span(axes, side, edge, 1.0)
    area = axes.get_window_extent()
    inch = len(side) / ((area.height if edge == "left" else area.width) / axes.figure.dpi)
    for i, cluster in enumerate(side.clusters):
        start, length = cluster.start - 0.5, cluster.stop - cluster.start
        box = ((0, start), 1, length) if edge == "left" else ((start, 0), length, 1)
        axes.add_patch(Rectangle(*box, facecolor=("#e9e9e9", "#d4d4d4")[i % 2], linewidth=0))
        middle = start + length / 2
        if length >= _LETTER * inch:
            axes.text(
                *((0.5, middle) if edge == "left" else (middle, 0.5)),
                cluster.letter,
                ha="center",
                va="center",
                fontsize=7.5,
                color=INK,
                clip_on=False,
            )


def _draw_tree(axes: Axes, side: Side, edge: Edge) -> None:
    if len(side) < 2:
        style.bare(axes, ticks=False)
        return
    tree = hierarchy.dendrogram(side.linkage, no_plot=True)
    # Leaves stand at 5, 15, ...
    positions, heights = np.array(tree["icoord"]) / 10 - 0.5, np.array(tree["dcoord"])
    _span(axes, side, edge, max(heights.max(), 1e-12) * 1.03)
    width = 0.7 if len(side) <= _MOST_NAMES else 0.4
    lines = np.stack((heights, positions) if edge == "left" else (positions, heights), axis=2)
    axes.add_collection(LineCollection(list(lines), colors=style.FAINT, linewidths=width))


def _span(axes: Axes, side: Side, edge: Edge, depth: float) -> None:
    """Set the limits of margin axes: along the policies, and outwards to a depth."""
    style.bare(axes, ticks=False)
    limits = (-0.5, len(side) - 0.5)
    if edge == "left":
        axes.set(xlim=(depth, 0), ylim=limits[::-1])
    else:
        axes.set(xlim=limits, ylim=(0, depth))


def _bracket(side: Side) -> float:
    return _BRACKET + _GAP if len(side.clusters) > 1 else 0.0


def _axis_title(what: str, side: Side) -> str:
    return what if len(side) <= _MOST_NAMES else f"{what}, n = {len(side)}"
