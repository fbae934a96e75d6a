"""Clustered cross-play heatmap (paper, Figure 4): dendrograms, strips, clusters, caption."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from scipy.cluster import hierarchy

from evaluation.plots import style
from evaluation.plots.crossplay.layout import (
    LEAST_LETTERS,
    Box,
    Layout,
    LegendPlace,
    lay_out,
    left_out,
)
from evaluation.plots.crossplay.legend import caption, draw_legend, headline, legend_blocks
from evaluation.plots.crossplay.matrix import Matrix, Side
from evaluation.plots.crossplay.traits import Trait, traits_of
from evaluation.plots.style import INK

Edge = Literal["left", "top"]
Place = Callable[[Box, str], Axes]  # axes at a place, with a label

_MARKED = 72  # policies of an axis: a larger matrix with a diagonal marks no pair
_BELOW = 0.05  # of pairs that may lie below the first colour


@style.own_style()
def crossplay_heatmap(
    matrix: Matrix,
    summary: Mapping[str, Any],
    *,
    width: float | None = None,
    legend: LegendPlace | None = None,
) -> Figure:
    """Draw a matrix in its order, with the figures of its summary.

    Args:
        matrix: The matrix.
        summary: What `crossplay` saved of it.
        width: Inches of the figure.
        legend: Place of the legend; None chooses "beside" or "below" by the room that there is.

    Raises:
        ValueError: The width is too small for the parts.
    """
    sides = (matrix.rows, matrix.columns)
    traits = traits_of(
        [name for side in sides for name in side.algorithms],
        [name for side in sides for name in side.disabilities],
    )
    blocks = legend_blocks(matrix, traits)
    layout = lay_out(matrix, len(traits), blocks, headline(summary), width=width, legend=legend)
    uncoloured = _bad_pairs_note(matrix.values)
    below = caption(matrix, summary, _marks(matrix, layout)) + uncoloured
    below += left_out(matrix, layout) + _strips_note(traits, layout)
    wide, high = layout.size[0], layout.size[1] + style.caption_height(below, layout.size[0])
    scale = layout.letters / 8.5
    title = f"Cross-play: {summary['task']}"
    figure = style.titled_figure(title, below, wide, high, size=12 * scale)
    under: dict[str, Any] = {"va": "top", "color": INK, "gid": style.WORDS}
    top = 1 - (0.14 + 0.28 * scale) / high
    figure.text(0.2 / wide, top, "\n".join(layout.head), fontsize=layout.letters, **under)

    def place(box: Box, label: str) -> Axes:
        x, y, width, height = box
        return figure.add_axes(
            (x / wide, 1 - (y + height) / high, width / wide, height / high), label=label
        )

    image = _draw_matrix(place(layout.matrix, "matrix"), matrix, layout)
    _draw_margin(place, layout, "left", matrix.rows, traits)
    _draw_margin(place, layout, "top", matrix.columns, traits)
    _draw_colour_bar(image, place(layout.bar, "colourbar"), layout, below=bool(uncoloured))
    if layout.legend:
        draw_legend(place(layout.legend_box, "legend"), layout.legend, layout.letters)
    return figure


def _draw_colour_bar(image: AxesImage, axes: Axes, layout: Layout, below: bool) -> None:
    lies = layout.bar_lies
    bar = axes.figure.colorbar(
        image,
        cax=axes,
        extend="min" if below else "neither",
        orientation="horizontal" if lies else "vertical",
        ticks=MaxNLocator(4) if lies else None,
    )
    small = max(7 * layout.letters / 8.5, 5.0)
    words: dict[str, Any] = {"fontsize": max(8 * layout.letters / 8.5, 5.0), "color": INK}
    if lies:
        middle: dict[str, Any] = {"transform": axes.transAxes, "va": "center"}
        axes.text(1.06, 0.5, "mean return of an episode", **words, **middle)
    else:
        bar.set_label("mean return of an episode", **words)
    axes.tick_params(labelsize=small, width=0.6, length=2.5, colors=INK, pad=2)
    axes.spines["outline"].set_visible(False)


def _draw_matrix(axes: Axes, matrix: Matrix, layout: Layout) -> AxesImage:
    values = matrix.values
    norm = Normalize(*_colour_ends(values))
    image = axes.imshow(
        values, cmap=style.COLOUR_MAP, norm=norm, aspect="auto", interpolation="nearest"
    )
    style.bare(axes, ticks=False)
    scale = layout.letters / 8.5
    title = _axis_title("human (partner)", matrix.columns, layout.names[1])
    axes.set_xlabel(title, fontsize=9 * scale, color=INK, labelpad=4 * scale)
    axes.yaxis.tick_right()
    if layout.names[1]:
        places = range(len(matrix.columns))
        axes.set_xticks(places, matrix.columns.names, rotation=90, fontsize=layout.names[1])
    if layout.names[0]:
        axes.set_yticks(range(len(matrix.rows)), matrix.rows.names, fontsize=layout.names[0])
    axes.tick_params(length=0, pad=2, colors=INK)
    apart = float(np.clip(0.35 * 72 * min(layout.cells), 0.5, 1.4))
    for draw, side in ((axes.axhline, matrix.rows), (axes.axvline, matrix.columns)):
        for cluster in side.clusters[1:]:
            draw(cluster.start - 0.5, color="white", linewidth=apart)
    if layout.figures:
        _write_values(axes, matrix, image, layout.figures)
    elif _marks(matrix, layout):
        _mark_self_play(axes, matrix, image, min(layout.cells))
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


def _marks(matrix: Matrix, layout: Layout) -> str:
    """Return the caption's text for the mark of self-play; empty if it is not marked."""
    if not matrix.self_play.any() or (matrix.shared and max(matrix.values.shape) > _MARKED):
        return ""
    return "by bold figures" if layout.figures else "by dots"


def _strips_note(traits: Sequence[Trait], layout: Layout) -> str:
    """Return the caption's sentence on the strips of a figure without a legend, else nothing."""
    if layout.legend:
        return ""
    levels = [trait.name for trait in traits if trait.ordinal]
    names = ", ".join(trait.name for trait in traits)
    lighter = f"; {' and '.join(levels)} are lighter as less is left" if levels else ""
    return f" Strips from the matrix outwards: {names}{lighter}."


def _write_values(axes: Axes, matrix: Matrix, image: AxesImage, size: float) -> None:
    for (row, column), value in np.ndenumerate(matrix.values):
        own = matrix.self_play[row, column]
        axes.text(
            column,
            row,
            f"{value:z.0f}",
            ha="center",
            va="center",
            color=_contrast(image, value),
            fontsize=size if own else max(size - 0.5, LEAST_LETTERS),
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
    place: Place, layout: Layout, edge: Edge, side: Side, traits: Sequence[Trait]
) -> None:
    """Draw, from the matrix outwards: traits, clusters, dendrogram."""
    seat = "ego" if edge == "left" else "partner"
    left, top, width, height = layout.matrix

    def beside(offset: float, thickness: float, label: str) -> Axes:
        if edge == "left":
            return place((left - offset - thickness, top, thickness, height), label)
        return place((left, top - offset - thickness, width, thickness), label)

    offset, scale = layout.gap, layout.letters / 8.5
    for trait in traits:
        axes = beside(offset, layout.strip, f"strip:{seat}:{trait.name}")
        _draw_strip(axes, side, trait, edge)
        if edge == "top":
            size = min(6.5, 0.85 * 72 * (layout.strip + layout.gap))
            corner: dict[str, Any] = {
                "transform": axes.transAxes,
                "ha": "right",
                "va": "center_baseline",
            }
            away = -layout.gap / width
            axes.text(away, 0.5, trait.name, fontsize=size, color=style.MUTED, **corner)
        offset += layout.strip + layout.gap
    if len(side.clusters) > 1:
        axes = beside(offset, layout.bracket, f"clusters:{seat}")
        _draw_brackets(axes, side, edge, 7.5 * scale)
        offset += layout.bracket + layout.gap
    tree = beside(offset, layout.tree, f"tree:{seat}")
    _draw_tree(tree, side, edge, thin=0.7 if min(layout.cells) > 0.09 else 0.4 * scale)
    if edge == "left":
        title = _axis_title("robot (ego)", side, layout.names[0])
        tree.set_ylabel(title, fontsize=9 * scale, color=INK, labelpad=4 * scale)


def _draw_strip(axes: Axes, side: Side, trait: Trait, edge: Edge) -> None:
    policies = zip(side.algorithms, side.disabilities, strict=True)
    values = [trait.value(*policy) for policy in policies]
    unknown = "white" if trait.ordinal else style.UNKNOWN
    colours = np.array([to_rgb(trait.colours[value] if value else unknown) for value in values])
    strip = colours[:, None] if edge == "left" else colours[None]
    axes.imshow(strip, aspect="auto", interpolation="nearest")
    style.bare(axes, ("left", "right", "top", "bottom"), ticks=False)
    for spine in axes.spines.values():
        spine.set_linewidth(0.3)


def _draw_brackets(axes: Axes, side: Side, edge: Edge, size: float) -> None:
    _span(axes, side, edge, 1.0)
    area = axes.get_window_extent()
    inch = len(side) / ((area.height if edge == "left" else area.width) / axes.figure.dpi)
    for i, cluster in enumerate(side.clusters):
        start, length = cluster.start - 0.5, cluster.stop - cluster.start
        box = ((0, start), 1, length) if edge == "left" else ((start, 0), length, 1)
        axes.add_patch(Rectangle(*box, facecolor=("#e9e9e9", "#d4d4d4")[i % 2], linewidth=0))
        middle = start + length / 2
        # Letters of smaller clusters would lie on each other.
        if length >= 0.86 * size / 72 * inch:
            axes.text(
                *((0.5, middle) if edge == "left" else (middle, 0.5)),
                cluster.letter,
                ha="center",
                va="center",
                fontsize=size,
                color=INK,
                clip_on=False,
            )


def _draw_tree(axes: Axes, side: Side, edge: Edge, thin: float) -> None:
    if len(side) < 2:
        style.bare(axes, ticks=False)
        return
    tree = hierarchy.dendrogram(side.linkage, no_plot=True)
    # Leaves stand at 5, 15, ...
    positions, heights = np.array(tree["icoord"]) / 10 - 0.5, np.array(tree["dcoord"])
    _span(axes, side, edge, max(heights.max(), 1e-12) * 1.03)
    lines = np.stack((heights, positions) if edge == "left" else (positions, heights), axis=2)
    axes.add_collection(LineCollection(list(lines), colors=style.FAINT, linewidths=thin))


def _span(axes: Axes, side: Side, edge: Edge, depth: float) -> None:
    """Set the limits of margin axes: along the policies, and outwards to a depth."""
    style.bare(axes, ticks=False)
    limits = (-0.5, len(side) - 0.5)
    if edge == "left":
        axes.set(xlim=(depth, 0), ylim=limits[::-1])
    else:
        axes.set(xlim=limits, ylim=(0, depth))


def _axis_title(what: str, side: Side, size: float) -> str:
    """Return the title of an axis, with the number of policies if their names are left out."""
    return what if size else f"{what}, n = {len(side)}"
