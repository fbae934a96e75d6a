"""Style of all figures: colours, and writing files without pyplot's global state."""

import contextlib
import io
import math
import textwrap
from collections.abc import Generator, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.style
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from matplotlib.typing import ColorType
from scipy.optimize import isotonic_regression

from assistax_base.files import atomic_write
from population.views import View

FORMATS = (".png", ".pdf", ".svg")
_UNDATED: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None, "Producer": None},
    ".svg": {"Date": None, "Creator": None},
}
_TEXT_STAYS_TEXT = {"pdf.fonttype": 42, "svg.fonttype": "none", "svg.hashsalt": "assistax-zoo"}
_SETTINGS: list[Any] = ["default", _TEXT_STAYS_TEXT]  # all of Matplotlib's
WIDEST = 40.0  # inches of a figure
INK = "#222222"
MUTED = "#555555"
FAINT = "#8a8a8a"
GRID = "#e5e5e5"
UNKNOWN = "#c8c8c8"  # a policy from outside the zoo
COLOUR_MAP = "viridis"
WORDS = "words"  # the id of texts around a figure, which a bare one lacks
END = 7.5  # points of the letters of a line's name at its end
BEHIND = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.6}  # of a name
_CAPTION_LINE, _MARGIN = 0.14, 0.04  # inches
# One colour for an algorithm in all figures and reports; an ego has its algorithm's. Algorithms and
# levels stand side by side in strips: all of these were chosen together, by a search for the
# largest least distance (CIEDE2000) for every vision. Tests hold what it found.
ALGORITHMS = {
    **{"ippo": "#990011", "mappo": "#ff8800", "isac": "#88eeaa", "masac": "#7777aa"},
    **{"mep": "#6a615f", "ppo": "#990011", "sac": "#88eeaa"},
}
# Of a league's rows beside ppo and sac, found by the same search.
ROWS = {
    **{"asymmetric": "#33bbaa", "asymmetric_gru": "#ff0088", "gru": "#0000dd", "liam": "#aabb66"},
    **{"palm": "#6699aa", "rl2": "#aa44ff", "rma": "#0055bb", "mirror": "#aa1177"},
    **{"osi": "#cc9988", "dagger": "#404858"},
    **{"told-preference": "#996677", "told-gru": "#550066", View.NUMBERS.condition: "#aa8855"},
}
OTHERS = ("#dd1111", "#cc99dd", "#005544", "#447744")  # of methods that are not ours
MARKERS, DASHES = ("o", "s", "^", "D", "v", "P"), ("-", "--", ":", "-.")
# One hue for each level of the elbow's range, lighter as strength falls.
_DISABILITY = {
    **{"d1": "#644600", "d2": "#a37402", "d3": "#d6a95f"},
    **{"d4": "#085cab", "d5": "#3d8ef6", "d6": "#acc3fe"},
    **{"d7": "#d01b70", "d8": "#fe70a3", "d9": "#fec9d8"},
}
# Of strips with an order: one hue each, lighter as less is left.
_LEVELS = {
    "strength": {1.0: "#013ee3", 0.7: "#9386ff", 0.4: "#e0d8ff"},
    "range": {1.0: "#883863", 0.7: "#d17ba6", 0.4: "#ffd0e5"},
}


@contextlib.contextmanager
def own_style() -> Generator[None]:
    """Run a block, or a decorated function, with only this project's Matplotlib settings.

    So equal figures give equal bytes under any matplotlibrc. The user's settings are restored
    afterwards.
    """
    with matplotlib.style.context(_SETTINGS):
        yield


def titled_figure(
    title: str, caption: str, width: float, height: float, *, drop: float = 0.14, size: float = 12
) -> Figure:
    """Return a white figure with a title at the top and a wrapped caption at the bottom.

    It is for functions that draw in `own_style`.

    Args:
        title: The title.
        caption: The caption, `caption_height` inches high; line breaks in it are kept.
        width: Width of the figure, in inches.
        height: Height of the figure, in inches.
        drop: Distance of the title from the upper edge, in inches.
        size: Font size of the title, in points.
    """
    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    x, y = 0.2 / width, 1 - drop / height
    head: dict[str, Any] = {"fontsize": size, "weight": "bold", "va": "top", "color": INK}
    figure.text(x, y, title, gid=WORDS, **head)
    foot: dict[str, Any] = {"fontsize": 7, "va": "bottom", "color": MUTED, "linespacing": 1.35}
    figure.text(x, 0.1 / height, "\n".join(_wrap(caption, width)), gid=WORDS, **foot)
    return figure


def caption_height(text: str, width: float) -> float:
    """Return the height of a caption in a figure of a width, both in inches."""
    return _CAPTION_LINE * len(_wrap(text, width))


def words(figure: Figure) -> str:
    """Return title and caption of a figure, also of a bare one, from the top, each on a line."""
    parts = [text for text in figure.texts if text.get_gid() == WORDS]
    parts.sort(key=lambda text: -text.get_position()[1])
    return "\n".join(" ".join(part.get_text().split()) for part in parts)


def check_width(width: float | None, least: float) -> None:
    """Raise a ValueError if a width in inches is too small or too large; None is allowed."""
    if width is not None and not least <= width <= WIDEST:
        raise ValueError(
            f"width is {width:g} inches; allowed for this figure are {least:g} to {WIDEST:g}"
        )


def spelled(name: str) -> str:
    """Return the name of a method in the spelling of figures, such as IPPO for "ippo".

    Characters of a folder's name that are not UTF-8 become question marks.
    """
    name = name.encode("utf-8", "replace").decode()
    return name.upper() if name.lower() in ALGORITHMS else name


def label_ends(
    axes: Axes, ends: Mapping[str, tuple[float, float]], colours: Mapping[str, str]
) -> None:
    """Write each line's name right of its end, moved up or down if names would overlap.

    The limits of the axes must be final.

    Args:
        axes: The axes of the lines.
        ends: x and y of each line's last point, by name.
        colours: The colour of each line, by name.
    """
    names = sorted(ends, key=lambda name: ends[name][::-1])
    if not names:
        return
    point = 72.0 / axes.figure.dpi
    heights = np.array([axes.transData.transform(ends[name])[1] * point for name in names])
    lines = np.array([1 + name.count("\n") for name in names])
    gaps = 1.2 * END * (np.cumsum(lines) - lines / 2)
    placed = isotonic_regression(heights - gaps).x + gaps
    for name, move in zip(names, placed - heights, strict=True):
        axes.annotate(
            name,
            ends[name],
            (4.0, float(move)),
            textcoords="offset points",
            va="center",
            fontsize=END,
            color=colours[name],
            annotation_clip=False,
            bbox=BEHIND,
        )


def room_for(names: Iterable[str]) -> float:
    """Return the inches that names at the ends of lines take."""
    longest = max((len(line) for name in names for line in name.split("\n")), default=0)
    return 0.15 + 0.6 * END / 72 * longest


def band(axes: Axes, table: pl.DataFrame, x: str, y: str, colour: str, label: str) -> None:
    """Draw a line, and its band between the columns low and high if they have values."""
    axes.plot(table[x], table[y], color=colour, linewidth=1.6, label=label)
    if not table["low"].null_count():
        ends = table[x], table["low"], table["high"]
        axes.fill_between(*ends, color=colour, alpha=0.18, linewidth=0)


def _wrap(text: str, width: float) -> list[str]:
    return [
        line for part in text.split("\n") for line in textwrap.wrap(part, int(18 * (width - 0.4)))
    ]


def check_path(path: Path) -> None:
    """Raise a ValueError if no figure can be written under a path's ending."""
    if path.suffix.lower() not in FORMATS:
        raise ValueError(
            f"{path.name} ends in {path.suffix or 'nothing'!r}; figures are written as "
            f"{', '.join(FORMATS)}"
        )


@own_style()
def save_figure(figure: Figure, path: Path, dpi: int = 200, *, bare: bool = False) -> Figure:
    """Write a figure as PNG, PDF or SVG, by the path's ending, atomically, and return it.

    A bare figure has neither title nor caption, and no room for them.
    """
    check_path(path)
    if bare:
        for text in figure.findobj(lambda part: part.get_gid() == WORDS):
            text.set_visible(False)
    box = _without_head_and_foot(figure) if bare else None
    atomic_write(path, figure_bytes(figure, path.suffix.lower(), dpi, box))
    return figure


def _without_head_and_foot(figure: Figure) -> Bbox:
    """Return the part of a figure without title and caption, in inches, of the full width."""
    drawn = figure.get_tightbbox(FigureCanvasAgg(figure).get_renderer())
    return Bbox.from_extents(
        0.0, drawn.y0 - _MARGIN, figure.get_size_inches()[0], drawn.y1 + _MARGIN
    )


@own_style()
def figure_bytes(figure: Figure, ending: str, dpi: int, part: Bbox | None = None) -> bytes:
    """Return a figure, or a part of it in inches, as a file of one of `FORMATS`.

    Equal figures give equal bytes. Text stays text, also in SVG.
    """
    content = io.BytesIO()
    how: dict[str, Any] = {"metadata": _UNDATED[ending], "format": ending[1:], "bbox_inches": part}
    figure.savefig(content, dpi=dpi, **how)
    return content.getvalue()


def algorithm_colours(names: Iterable[str | None]) -> dict[str, str]:
    """Return the colours of algorithms, by name; other methods take colours in sorted order."""
    known = sorted({name for name in names if name is not None})
    spare = iter(OTHERS * len(known))
    return {name: (ALGORITHMS | ROWS).get(name.lower()) or next(spare) for name in known}


def disability_colours(names: Iterable[str | None]) -> dict[str, str]:
    """Return the colours of disability settings, by name; those beyond d1..d9 from a colour map."""
    known = sorted({name for name in names if name is not None})
    others = [name for name in known if name not in _DISABILITY]
    spare = matplotlib.colormaps["PRGn"]
    extra = {
        name: to_hex(spare(0.05 + 0.9 * i / max(len(others) - 1, 1)))
        for i, name in enumerate(others)
    }
    return {name: _DISABILITY.get(name, extra.get(name, UNKNOWN)) for name in known}


def level_colour(trait: str, level: float) -> str:
    """Return the colour of a level of "strength" or "range", a share that is left."""
    return _LEVELS[trait][level]


def bare(axes: Axes, sides: Sequence[str] = (), *, ticks: bool = True) -> None:
    """Hide the frame of axes except the named sides, and the ticks if `ticks` is False."""
    for side, spine in axes.spines.items():
        spine.set_visible(side in sides)
        spine.set_color(FAINT)
    axes.tick_params(colors=INK, length=3, width=0.6)
    if not ticks:
        axes.set(xticks=[], yticks=[])


def whole_decades(axes: Axes, values: pl.Series) -> None:
    """Set the limits of a logarithmic axis to powers of ten around the values."""
    known = [value for value in values.to_list() if value and value > 0]
    if known:
        low, high = math.floor(math.log10(min(known))), math.ceil(math.log10(max(known)))
        axes.set_ylim(10.0**low, 10.0 ** max(high, low + 1))


def ink_on(colour: ColorType) -> str:
    """Return black or white, the one with more contrast to a colour."""
    red, green, blue = to_rgb(colour)
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 0.5 else "white"
