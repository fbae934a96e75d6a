"""What all figures share: colours, and writing PNG or PDF without pyplot's global state."""

import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib
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


def new_figure(width: float, height: float) -> Figure:
    """Return an empty white figure of a size in inches."""
    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def caption_height(text: str, width: float) -> float:
    """Return the height that a caption takes at the foot of a figure of a width, in inches."""
    return _CAPTION_LINE * len(_wrap(text, width))


def _wrap(text: str, width: float) -> list[str]:
    """Break a caption into lines for a figure of a width in inches; its own lines stay apart."""
    return [
        line for part in text.split("\n") for line in textwrap.wrap(part, int(15.5 * (width - 0.4)))
    ]


def write_caption(figure: Figure, text: str) -> None:
    """Write a caption of `caption_height` inches at the foot of a figure, broken into lines."""
    width, height = figure.get_size_inches()
    lines = "\n".join(_wrap(text, width))
    figure.text(
        0.2 / width, 0.1 / height, lines, fontsize=7, va="bottom", color=MUTED, linespacing=1.35
    )


def check_path(path: Path) -> Path:
    """Return the path if a figure can be written under its name, before any work is done."""
    if path.suffix.lower() not in FORMATS:
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; figures are written as .png or .pdf"
        )
    return path


def save_figure(figure: Figure, path: Path, dpi: int = 200) -> None:
    """Write a figure as PNG or PDF, by the path's ending; equal figures give equal bytes."""
    check_path(path)
    pdf = path.suffix.lower() == ".pdf"
    metadata = {"CreationDate": None, "Producer": None} if pdf else {"Software": None}
    with atomic_path(path) as temporary, matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(temporary, dpi=dpi, metadata=metadata, format=path.suffix[1:].lower())


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


def bare(axes: Axes, sides: Sequence[str] = ()) -> None:
    """Hide the frame of the axes but for the named sides."""
    for side, spine in axes.spines.items():
        spine.set_visible(side in sides)
        spine.set_color(FAINT)
    axes.tick_params(colors=INK, length=3, width=0.6)


def ink_on(colour: ColorType) -> str:
    """Return black or white, whichever is read better on a colour."""
    red, green, blue = to_rgb(colour)
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"


def counted(count: int, what: str) -> str:
    """Return a number of things in words: "1 seed", "2 seeds"."""
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
