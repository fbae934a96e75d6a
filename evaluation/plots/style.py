"""What all figures share: colours, and writing PNG or PDF without pyplot's global state."""

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.typing import ColorType

from population.files import atomic_path

FORMATS = (".png", ".pdf")
INK = "#222222"
MUTED = "#555555"
FAINT = "#8a8a8a"
GRID = "#e5e5e5"
UNKNOWN = "#c8c8c8"  # a policy from outside the zoo
COLOUR_MAP = "viridis"
_CAPTION_LINE = 0.14  # inches
# Okabe and Ito (2008); first those that are unlike the colours of disability settings.
OKABE_ITO = ("#009E73", "#CC79A7", "#F0E442", "#D55E00", "#56B4E9", "#0072B2", "#E69F00", "#000000")
# One hue for each level of the elbow's range, lighter as strength falls; blue, orange and grey
# differ for every vision.
_DISABILITY = {
    **{"d1": "#0b4fa0", "d2": "#4393d5", "d3": "#a6d5f7"},
    **{"d4": "#8c2d04", "d5": "#e6550d", "d6": "#fdb777"},
    **{"d7": "#151515", "d8": "#6a6a6a", "d9": "#b3b3b3"},
}


def titled_figure(
    title: str, caption: str, width: float, height: float, *, drop: float = 0.14, size: float = 12
) -> Figure:
    """Return a white figure with a title at its head and a caption, broken into lines, at its foot.

    Args:
        title: Written `drop` inches below the upper edge, in letters of `size` points.
        caption: Takes `caption_height` inches; its own lines stay apart.
        width: In inches.
        height: In inches.
        drop: In inches.
        size: In points.
    """
    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    x, y = 0.2 / width, 1 - drop / height
    figure.text(x, y, title, fontsize=size, weight="bold", va="top", color=INK)
    lines = "\n".join(_wrap(caption, width))
    figure.text(x, 0.1 / height, lines, fontsize=7, va="bottom", color=MUTED, linespacing=1.35)
    return figure


def caption_height(text: str, width: float) -> float:
    """Return the height that a caption takes at the foot of a figure of a width, in inches."""
    return _CAPTION_LINE * len(_wrap(text, width))


def band(axes: Axes, table: pl.DataFrame, x: str, y: str, colour: str, label: str) -> None:
    """Draw a line, and from the columns low to high its band where there is one."""
    axes.plot(table[x], table[y], color=colour, linewidth=1.6, label=label)
    if not table["low"].null_count():
        ends = table[x], table["low"], table["high"]
        axes.fill_between(*ends, color=colour, alpha=0.18, linewidth=0)


def dark(number: int) -> str:
    """Return one of the colours in turn, first those that are dark on white."""
    return OKABE_ITO[(number + 5) % len(OKABE_ITO)]


def _wrap(text: str, width: float) -> list[str]:
    return [
        line for part in text.split("\n") for line in textwrap.wrap(part, int(15.5 * (width - 0.4)))
    ]


def check_path(path: Path) -> None:
    """Check, before any work is done, that a figure can be written under its name."""
    if path.suffix.lower() not in FORMATS:
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; figures are written as .png or .pdf"
        )


def save_figure(figure: Figure, path: Path, dpi: int = 200) -> Figure:
    """Write a figure as PNG or PDF, by the path's ending; equal figures give equal bytes."""
    check_path(path)
    pdf = path.suffix.lower() == ".pdf"
    metadata = {"CreationDate": None, "Producer": None} if pdf else {"Software": None}
    with atomic_path(path) as temporary, matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(temporary, dpi=dpi, metadata=metadata, format=path.suffix[1:].lower())
    return figure


def algorithm_colours(names: Iterable[str | None]) -> dict[str, str]:
    """Give each algorithm a colour, by its place in the alphabet; beyond eight they repeat."""
    known = sorted({name for name in names if name is not None})
    return {name: OKABE_ITO[i % len(OKABE_ITO)] for i, name in enumerate(known)}


def disability_colours(names: Iterable[str | None]) -> dict[str, str]:
    """Give each disability setting its colour; settings beyond d1..d9 take colours from a map."""
    known = sorted({name for name in names if name is not None})
    others = [name for name in known if name not in _DISABILITY]
    spare = matplotlib.colormaps["PRGn"]
    extra = {
        name: to_hex(spare(0.05 + 0.9 * i / max(len(others) - 1, 1)))
        for i, name in enumerate(others)
    }
    return {name: _DISABILITY.get(name, extra.get(name, UNKNOWN)) for name in known}


def bare(axes: Axes, sides: Sequence[str] = (), *, ticks: bool = True) -> None:
    """Hide the frame of the axes but for the named sides, and the ticks if they are not wanted."""
    for side, spine in axes.spines.items():
        spine.set_visible(side in sides)
        spine.set_color(FAINT)
    axes.tick_params(colors=INK, length=3, width=0.6)
    if not ticks:
        axes.set(xticks=[], yticks=[])


def ink_on(colour: ColorType) -> str:
    """Return black or white, whichever is read better on a colour."""
    red, green, blue = to_rgb(colour)
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"


def counted(count: int, what: str) -> str:
    """Return a number of things in words: "1 seed", "2 seeds"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
