"""Places of a cross-play heatmap's parts, in inches from the upper left corner."""

import dataclasses
from typing import Literal, get_args

import numpy as np

from evaluation.plots import style
from evaluation.plots.crossplay.legend import Item, Legend, flowed, stacked, text_width
from evaluation.plots.crossplay.matrix import Matrix, Side

LegendPlace = Literal["beside", "below", "none"]
Box = tuple[float, float, float, float]  # left, top, width, height

LEAST_LETTERS = 4.0  # points; smaller labels are left out
_LONGER = 6.4  # inches of a matrix's longer side in a figure without a given width
_SMALLEST = 1.0  # of a longer side
_FEW, _FEW_CELL, _LARGEST_CELL = 10, 0.2, 0.6  # an axis with few policies keeps this cell
_MOST_FIGURES = 14  # a matrix of at most this size shows its numbers
_COLUMN = 5.0  # a narrower figure has its colour bar below
_BAR, _BAR_ROOM = 1.6, 0.75  # length of the colour bar, and its depth with figures
_BESIDE = 0.45  # of a figure's width: least matrix beside a legend
_DEEPER = 0.4  # of the matrix's height: what a legend beside it may reach below it
_NAMES = 0.35  # of a figure's width: most room for the rows' names
_DEEPEST = 1.3  # times a figure's width: longest matrix
_TRIES = 300
_BETWEEN = "; "  # figures of the headline


@dataclasses.dataclass(frozen=True)
class Layout:
    """Places and sizes of the parts."""

    cells: tuple[float, float]  # height of a row, width of a column
    matrix: Box
    bar: Box
    bar_lies: bool  # below the matrix
    legend_box: Box
    legend: Legend | None
    names: tuple[float, float]  # points of the rows' and the columns' names; 0 if left out
    figures: float  # points of the numbers in cells; 0 if there are none
    head: list[str]  # lines of the headline
    letters: float  # points
    strip: float  # thickness of a strip
    gap: float  # between strips
    bracket: float  # thickness of the clusters' letters
    tree: float  # thickness of a dendrogram
    size: tuple[float, float]  # of all, width and height, without the caption


def lay_out(
    matrix: Matrix,
    strips: int,
    blocks: list[list[Item]],
    headline: str,
    *,
    width: float | None = None,
    legend: LegendPlace | None = None,
) -> Layout:
    """Return the layout with the largest matrix for a width in inches.

    Without a place for the legend, the legend is beside a matrix that is large enough, else below.

    Raises:
        ValueError: The place is unknown, or the width too small for the parts.
    """
    if legend is not None and legend not in get_args(LegendPlace):
        raise ValueError(f"legend is {legend!r}; allowed are {', '.join(get_args(LegendPlace))}")
    plan = _Plan(matrix, strips, blocks, headline, width)
    if legend is not None:
        return plan.largest(legend)
    if plan.fits("beside"):
        beside = plan.largest("beside")
        _, top, across, deep = beside.matrix
        room = top + (1 + _DEEPER) * deep
        fits = beside.legend_box[1] + beside.legend_box[3] <= room
        if fits and max(across, deep) >= _BESIDE * beside.size[0]:
            return beside
    return plan.largest("below")


@dataclasses.dataclass(frozen=True)
class _Plan:
    """Parts that take room, and the figure's width if it is given."""

    drawn: Matrix
    strips: int
    blocks: list[list[Item]]
    headline: str
    width: float | None

    @property
    def scale(self) -> float:
        """Return the size of letters, in a wide figure 1."""
        return 1.0 if self.width is None else float(np.clip(0.55 + 0.05 * self.width, 0.7, 1.0))

    def fits(self, place: LegendPlace) -> bool:
        return self.width is None or self.place(_SMALLEST, place).size[0] <= self.width

    def largest(self, place: LegendPlace) -> Layout:
        """Return the largest layout of the width.

        Raises:
            ValueError: The width is too small.
        """
        if self.width is None:
            return self.place(_LONGER, place)
        least = self.place(_SMALLEST, place).size[0]
        style.check_width(self.width, float(np.ceil(10 * least) / 10))
        for longer in np.linspace(_DEEPEST * self.width, _SMALLEST, _TRIES):
            found = self.place(float(longer), place)
            if found.size[0] <= self.width:
                break
        return dataclasses.replace(found, size=(self.width, found.size[1]))

    def place(self, longer: float, place: LegendPlace) -> Layout:
        """Return the layout around a matrix whose longer side has a length."""
        scale, (rows, columns) = self.scale, self.drawn.values.shape
        thin = scale**2
        strip, gap, tree, bracket = 0.13 * thin, 0.035 * thin, 0.38 * thin, 0.17 * scale
        square = min(longer / max(rows, columns), _LARGEST_CELL)
        high, wide = (max(square, _FEW_CELL) if n <= _FEW else square for n in (rows, columns))
        names, rooms = self._names(high, wide)
        margins = [
            tree + self.strips * (strip + gap) + gap + _brackets(side, bracket + gap)
            for side in (self.drawn.rows, self.drawn.columns)
        ]
        head = self._head()
        # The strips' names stand left of the upper strips, where the left margin's other parts are.
        left = max(0.42 * thin + 0.05 + margins[0], 0.85 * scale)
        top = 0.5 * scale + 0.04 + 0.02 * len(head) + _line(8.5 * scale) * len(head) + margins[1]
        width, height = columns * wide, rows * high
        right, bottom = left + width + rooms[0], top + height + rooms[1] + 0.26 * scale
        lies = self.width is not None and self.width < _COLUMN
        if lies:
            bar = (left, bottom, min(_BAR, 0.5 * max(width, _SMALLEST)), 0.08)
            bottom += 0.08 + 0.25 * scale
            start, first = right + 0.2 * scale, top
        else:
            start = right + 0.3 * scale
            bar = (start, top, 0.15 * scale, min(_BAR, max(height, _SMALLEST)))
            right, first = start + _BAR_ROOM * scale, top + bar[3] + 0.25
            bottom = max(bottom, top + bar[3] + 0.15)
        legend, box = None, (0.0, 0.0, 0.0, 0.0)
        if place == "beside":
            legend = stacked(self.blocks, 8.5 * scale)
            box = (start, first, legend.width, legend.height)
            right = max(right, start + legend.width)
        elif place == "below":
            across = (max(right, 4.0) if self.width is None else self.width) - 0.3
            legend = flowed(self.blocks, 8.5 * scale, across)
            box = (0.2, bottom, across, legend.height)
        bottom = max(bottom, box[1] + box[3])
        right = max(right, 0.2 + max(text_width(line, 8.5 * scale) for line in head))
        return Layout(
            cells=(high, wide),
            matrix=(left, top, width, height),
            bar=bar,
            bar_lies=lies,
            legend_box=box,
            legend=legend,
            names=names,
            figures=self._figures(high, wide),
            head=head,
            letters=8.5 * scale,
            strip=strip,
            gap=gap,
            bracket=bracket,
            tree=tree,
            size=(right + 0.15 * scale, bottom + 0.15 * scale),
        )

    def _head(self) -> list[str]:
        """Return the lines of the headline, broken between its figures."""
        first, *others = self.headline.split(_BETWEEN)
        room, lines = (self.width or style.WIDEST) - 0.4, [first]
        for part in others:
            longer = f"{lines[-1]}{_BETWEEN}{part}"
            if text_width(longer, 8.5 * self.scale) <= room:
                lines[-1] = longer
            else:
                lines[-1] += _BETWEEN.rstrip()
                lines.append(part)
        return lines

    def _names(self, high: float, wide: float) -> tuple[tuple[float, float], list[float]]:
        """Return the names' sizes in points, and the inches that they take beside the matrix."""
        sizes, rooms = [], []
        for side, cell in ((self.drawn.rows, high), (self.drawn.columns, wide)):
            longest = max(text_width(name, 10.0) for name in side.names) / 10.0  # a point
            size = min(7.5 * self.scale, 0.8 * 72 * cell)
            if side is self.drawn.rows and self.width is not None:
                size = min(size, _NAMES * self.width / longest)
            size = size if size >= LEAST_LETTERS else 0.0
            sizes.append(size)
            rooms.append(0.05 + longest * size if size else 0.0)
        return (sizes[0], sizes[1]), rooms

    def _figures(self, high: float, wide: float) -> float:
        """Return the size in points of the numbers in cells; 0 if there are none."""
        if max(self.drawn.values.shape) > _MOST_FIGURES:
            return 0.0
        longest = max(text_width(f"{v:z.0f}", 10.0, bold=True) for v in self.drawn.values.flat)
        size = min(7.5, 0.8 * 72 * high, 9.0 * wide / longest)
        return size if size >= LEAST_LETTERS else 0.0


def left_out(matrix: Matrix, layout: Layout) -> str:
    """Return the caption's sentence on labels that would be too small; empty without any."""
    parts = [
        f"names of {len(side)} {what}"
        for side, size, what in (
            (matrix.rows, layout.names[0], "robots"),
            (matrix.columns, layout.names[1], "humans"),
        )
        if not size
    ]
    if max(matrix.values.shape) <= _MOST_FIGURES and not layout.figures:
        parts.append("numbers in cells")
    if not parts:
        return ""
    return f" Left out, as smaller than {LEAST_LETTERS:g} points: {', '.join(parts)}."


def _brackets(side: Side, room: float) -> float:
    return room if len(side.clusters) > 1 else 0.0


def _line(points: float) -> float:
    return 1.25 * points / 72
