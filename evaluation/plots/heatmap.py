"""Clustered cross-play heatmap (paper, Figure 4): dendrograms, strips, clusters, caption."""

import dataclasses
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
from evaluation.plots.legend import LINE, caption, draw_legend, legend_lines, write_texts
from evaluation.plots.matrix import Matrix, Side

Edge = Literal["left", "top"]

# Inches.
_MATRIX = 6.4  # longer side of the matrix
_STRIP, _GAP = 0.13, 0.035
_BRACKET = 0.17  # strip of cluster letters
_LETTER = 0.09  # least bracket with a letter: letters of smaller clusters would lie on each other
_TREE = 0.42
_LEGEND = 2.5
_COLOUR_BAR = 1.6
_FEW, _FEW_CELL = 10, 0.2  # an axis with few policies is drawn this wide, whatever the other has
_HEAD = 0.72

_MOST_NAMES = 72  # an axis with more policies shows clusters, not names
_MOST_FIGURES = 14  # a matrix of at most this size shows its numbers


@dataclasses.dataclass(frozen=True)
class _Layout:
    """Places in inches from the top left corner."""

    cells: tuple[float, float]  # height of a row, width of a column
    left: float  # where the matrix begins
    top: float
    width: float  # of the matrix
    height: float
    name_room: tuple[float, float]  # right of the rows, below the columns
    legend_height: float
    caption_height: float = 0.0

    @property
    def legend_left(self) -> float:
        return self.left + self.width + self.name_room[0] + 0.3

    @property
    def size(self) -> tuple[float, float]:
        below = self.height + self.name_room[1] + 0.3
        beside = _COLOUR_BAR + 0.25 + self.legend_height
        return self.legend_left + _LEGEND, self.top + max(
            below, beside
        ) + 0.15 + self.caption_height


def crossplay_heatmap(matrix: Matrix, summary: Mapping[str, Any]) -> Figure:
    """Draw a matrix in its order with what its summary says."""
    palettes = {
        "algorithm": style.algorithm_colours([*matrix.rows.algorithms, *matrix.columns.algorithms]),
        "disability": style.disability_colours(
            [*matrix.rows.disabilities, *matrix.columns.disabilities]
        ),
    }
    lines = legend_lines(matrix, palettes["algorithm"], palettes["disability"])
    layout = _layout(matrix, len(lines))
    below = caption(matrix, summary, _marks(matrix))
    layout = dataclasses.replace(layout, caption_height=style.caption_height(below, layout.size[0]))
    size = layout.size
    figure = style.new_figure(*size)

    def place(x: float, y: float, width: float, height: float, label: str) -> Axes:
        corner = (x / size[0], 1 - (y + height) / size[1])
        return figure.add_axes((*corner, width / size[0], height / size[1]), label=label)

    heat = place(layout.left, layout.top, layout.width, layout.height, "matrix")
    image = _draw_matrix(heat, matrix, layout.cells)
    _draw_margin(place, layout, "left", matrix.rows, palettes)
    _draw_margin(place, layout, "top", matrix.columns, palettes)
    _draw_colour_bar(image, place(layout.legend_left, layout.top, 0.15, _COLOUR_BAR, "colourbar"))
    legend_top = layout.top + _COLOUR_BAR + 0.25
    draw_legend(
        place(layout.legend_left, legend_top, _LEGEND, max(layout.legend_height, LINE), "legend"),
        lines,
    )
    write_texts(figure, summary, below)
    return figure


def _layout(matrix: Matrix, legend_lines: int) -> _Layout:
    rows, columns = matrix.values.shape
    square = min(_MATRIX / max(rows, columns), 0.6)
    cells = [max(square, _FEW_CELL) if count <= _FEW else square for count in (rows, columns)]
    sides = zip((matrix.rows, matrix.columns), cells, strict=True)
    rooms = [_name_room(side, _name_size(cell)) for side, cell in sides]
    margins = [
        _TREE + 2 * (_STRIP + _GAP) + _GAP + _bracket(side)
        for side in (matrix.rows, matrix.columns)
    ]
    return _Layout(
        cells=(cells[0], cells[1]),
        left=0.42 + margins[0],
        top=_HEAD + margins[1],
        width=columns * cells[1],
        height=rows * cells[0],
        name_room=(rooms[0], rooms[1]),
        legend_height=LINE * legend_lines,
    )


def _draw_colour_bar(image: AxesImage, axes: Axes) -> None:
    bar = axes.figure.colorbar(image, cax=axes)
    bar.set_label("mean return", fontsize=8, color=style.INK)
    axes.tick_params(labelsize=7, width=0.6, length=2.5, colors=style.INK)
    axes.spines["outline"].set_visible(False)


def _name_size(cell: float) -> float:
    """Points of the policies' names beside cells of this size in inches."""
    return min(7.5, 0.8 * 72 * cell)


def _name_room(side: Side, size: float) -> float:
    """Inches that the policies' names take beside the matrix."""
    return 0.05 + 0.62 * size / 72 * max(map(len, side.names)) if len(side) <= _MOST_NAMES else 0.05


def _draw_matrix(axes: Axes, matrix: Matrix, cells: tuple[float, float]) -> AxesImage:
    values = matrix.values
    low, high = float(values.min()), float(values.max())
    norm = Normalize(low, high if high > low else low + 1.0)
    image = axes.imshow(
        values, cmap=style.COLOUR_MAP, norm=norm, aspect="auto", interpolation="nearest"
    )
    style.bare(axes)
    axes.set_xlabel(
        _axis_title("human (partner)", matrix.columns), fontsize=9, color=style.INK, labelpad=4
    )
    axes.set_xticks([])
    axes.set_yticks([])
    axes.yaxis.tick_right()
    if len(matrix.columns) <= _MOST_NAMES:
        axes.set_xticks(
            range(len(matrix.columns)),
            matrix.columns.names,
            rotation=90,
            fontsize=_name_size(cells[1]),
        )
    if len(matrix.rows) <= _MOST_NAMES:
        axes.set_yticks(range(len(matrix.rows)), matrix.rows.names, fontsize=_name_size(cells[0]))
    axes.tick_params(length=0, pad=2, colors=style.INK)
    for draw, side in ((axes.axhline, matrix.rows), (axes.axvline, matrix.columns)):
        for cluster in side.clusters[1:]:
            draw(cluster.start - 0.5, color="white", linewidth=1.4)
    if max(values.shape) <= _MOST_FIGURES:
        _write_values(axes, matrix, image)
    elif _marks(matrix):
        _mark_self_play(axes, matrix, image, min(cells))
    return image


def _marks(matrix: Matrix) -> str:
    """Return how self-play is marked: not at all along a diagonal too fine for dots."""
    size = max(matrix.values.shape)
    if not matrix.self_play.any() or (matrix.shared and size > _MOST_NAMES):
        return ""
    return "by bold figures" if size <= _MOST_FIGURES else "by dots"


def _write_values(axes: Axes, matrix: Matrix, image: AxesImage) -> None:
    own = matrix.self_play
    for (row, column), value in np.ndenumerate(matrix.values):
        font = {
            "fontsize": 7.5 if own[row, column] else 7,
            "weight": "bold" if own[row, column] else "normal",
        }
        axes.text(
            column,
            row,
            f"{value:.0f}",
            ha="center",
            va="center",
            color=_contrast(image, value),
            fontdict=font,
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
        tree.set_ylabel(_axis_title("robot (ego)", side), fontsize=9, color=style.INK, labelpad=4)


def _draw_strip(
    axes: Axes, values: Sequence[str | None], palette: Mapping[str, str], edge: Edge, title: str
) -> None:
    colours = np.array(
        [to_rgb(palette[value] if value is not None else style.UNKNOWN) for value in values]
    )
    axes.imshow(
        colours[:, None] if edge == "left" else colours[None],
        aspect="auto",
        interpolation="nearest",
    )
    axes.set_xticks([])
    axes.set_yticks([])
    style.bare(axes)
    if edge == "top":
        axes.text(
            1.01, 0.5, title, transform=axes.transAxes, fontsize=6.5, color=style.FAINT, va="center"
        )


def _draw_brackets(axes: Axes, side: Side, edge: Edge) -> None:
    style.bare(axes)
    axes.set_xticks([])
    axes.set_yticks([])
    limits = (-0.5, len(side) - 0.5)
    axes.set(
        **(
            {"ylim": limits[::-1], "xlim": (0, 1)}
            if edge == "left"
            else {"xlim": limits, "ylim": (0, 1)}
        )
    )
    area = axes.get_window_extent()
    inch = len(side) / ((area.height if edge == "left" else area.width) / axes.figure.dpi)
    for i, cluster in enumerate(side.clusters):
        start, length = cluster.start - 0.5, cluster.stop - cluster.start
        box = ((0, start), 1, length) if edge == "left" else ((start, 0), length, 1)
        axes.add_patch(Rectangle(*box, facecolor=("#e9e9e9", "#d4d4d4")[i % 2], linewidth=0))
        middle = start + length / 2
        x, y = (0.5, middle) if edge == "left" else (middle, 0.5)
        if length >= _LETTER * inch:
            axes.text(
                x,
                y,
                cluster.letter,
                ha="center",
                va="center",
                fontsize=7.5,
                color=style.INK,
                clip_on=False,
            )


def _draw_tree(axes: Axes, side: Side, edge: Edge) -> None:
    style.bare(axes)
    axes.set_xticks([])
    axes.set_yticks([])
    if len(side) < 2:
        return
    tree = hierarchy.dendrogram(side.linkage, no_plot=True)
    positions, heights = (
        np.array(tree["icoord"]) / 10 - 0.5,
        np.array(tree["dcoord"]),
    )  # leaves stand at 5, 15, ...
    width = 0.7 if len(side) <= _MOST_NAMES else 0.4
    limits, depth = (-0.5, len(side) - 0.5), (0, max(heights.max(), 1e-12) * 1.03)
    lines = np.stack((heights, positions) if edge == "left" else (positions, heights), axis=2)
    axes.add_collection(LineCollection(list(lines), colors=style.FAINT, linewidths=width))
    if edge == "left":
        axes.set(xlim=depth[::-1], ylim=limits[::-1])
    else:
        axes.set(xlim=limits, ylim=depth)


def _bracket(side: Side) -> float:
    return _BRACKET + _GAP if len(side.clusters) > 1 else 0.0


def _axis_title(what: str, side: Side) -> str:
    return what if len(side) <= _MOST_NAMES else f"{what}, n = {len(side)}"
