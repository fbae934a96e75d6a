"""What all figures share: colours, and writing files without pyplot's global state."""

import io
import textwrap
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.typing import ColorType

from assistax_base.files import atomic_write

FORMATS = (".png", ".pdf", ".svg")
_UNDATED: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}
INK = "#222222"
MUTED = "#555555"
FAINT = "#8a8a8a"
GRID = "#e5e5e5"
UNKNOWN = "#c8c8c8"  # a policy from outside the zoo
COLOUR_MAP = "viridis"
_CAPTION_LINE = 0.14  # inches
# One colour for an algorithm in all figures and reports. They differ for every vision and in grey,
# and from every colour of the map, beside which they stand. An ego has its algorithm's colour.
ALGORITHMS = {
    **{"ippo": "#1e0ff0", "mappo": "#e17800", "isac": "#1e0000", "masac": "#b41ec3"},
    **{"mep": "#690f00", "ppo": "#1e0ff0", "sac": "#1e0000"},
}
OTHERS = ("#f0003c", "#ffb4d2", "#ff78e1", "#a52d5a")  # of methods that are not ours
MARKERS = ("o", "s", "^", "D", "v", "P")
# One hue for each level of the elbow's range, lighter as strength falls; as far from the map.
_DISABILITY = {
    **{"d1": "#7800a5", "d2": "#5a4bff", "d3": "#b487f0"},
    **{"d4": "#690000", "d5": "#c31e0f", "d6": "#ff7800"},
    **{"d7": "#4b0f2d", "d8": "#964b5a", "d9": "#ffb4b4"},
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


def _wrap(text: str, width: float) -> list[str]:
    return [
        line for part in text.split("\n") for line in textwrap.wrap(part, int(15.5 * (width - 0.4)))
    ]


def check_path(path: Path) -> None:
    """Check, before any work is done, that a figure can be written under its name."""
    if path.suffix.lower() not in FORMATS:
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; figures are written as "
            f"{', '.join(FORMATS)}"
        )


def save_figure(figure: Figure, path: Path, dpi: int = 200) -> Figure:
    """Write a figure as PNG, PDF or SVG, by its ending, whole or not at all."""
    check_path(path)
    atomic_write(path, figure_bytes(figure, path.suffix.lower(), dpi))
    return figure


def figure_bytes(figure: Figure, ending: str, dpi: int) -> bytes:
    """Return a figure as a file of one of `FORMATS`; equal figures give equal bytes."""
    content = io.BytesIO()
    fixed: dict[Any, Any] = {"pdf.fonttype": 42, "svg.hashsalt": "assistax-zoo"}
    with matplotlib.rc_context(fixed):
        figure.savefig(content, dpi=dpi, metadata=_UNDATED[ending], format=ending[1:])
    return content.getvalue()


def algorithm_colours(names: Iterable[str | None]) -> dict[str, str]:
    """Give each algorithm its colour; other methods take turns, by their place in the alphabet."""
    known = sorted({name for name in names if name is not None})
    others = [name for name in known if name.lower() not in ALGORITHMS]
    spare = {name: OTHERS[i % len(OTHERS)] for i, name in enumerate(others)}
    return {name: spare.get(name) or ALGORITHMS[name.lower()] for name in known}


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
