"""The strip below a picture: clock, reward terms as bars, force, and a legend of colours."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from assistax_envs.preferences import WORDS
from assistax_envs.tasks.gentle_rules import HARD

INK, PAPER, TRACK = (25, 30, 38), (250, 250, 251), (222, 226, 231)
EARNS, COSTS = (70, 82, 100), (128, 90, 190)
# N, and the colour from there on: below a gentle touch, above it, more than a frail face bears.
# They differ in grey too, from targets as well.
LEVELS = ((0.0, (60, 190, 140)), (10.0, (245, 205, 60)), (HARD, (140, 20, 10)))
MEANINGS = {
    "ends": "ends of the stroke",
    "next": "next to wipe",
    "section": "where to hold the arm",
    "waist": "where the arm goes",
    "mouth": "where the spoon goes",
    "place": "what is brushed next",
}  # of targets' names
_LONGEST = f"says: {max(WORDS, key=len)}"
SMALLEST = 100  # pixels: what is lower has no room for words
MOST_WITH_TERMS, MOST_WITH_NAMES = 0.42, 1 / 3  # of a picture's height, for words


@dataclasses.dataclass(frozen=True)
class Figures:
    """Figures of one step of one simulation, written below its picture."""

    title: str
    terms: dict[str, float]  # weighted reward terms
    force: float  # N
    distance: float  # m
    nonfinite: bool
    targets: Mapping[str, tuple[float, ...]]  # colours, RGBA
    word: str | None = None  # that is heard of the human; "" in silence, None if nobody can speak


def force_colour(newtons: float) -> tuple[float, ...]:
    """Return the colour of a force, RGBA."""
    return (*(channel / 255 for channel in _level(newtons)), 1.0)


def heard_word(one: Any) -> str | None:
    """Return the human's word that is heard in a state of one simulation.

    It is "" in silence, and None in tasks without words.
    """
    if one.word is None:
        return None
    code = int(one.word[0]) if int(one.heard[0]) > 0 else 0
    return WORDS[code - 1] if code else ""


def panel_height(width: int, height: int, figures: Figures, caption: tuple[str, ...]) -> int:
    """Return the height in pixels that the words take of a picture; 0 if there is no room."""
    if height < SMALLEST:
        return 0
    font = _font(width, height)
    return min(_height(font, _lines(font, width, height, figures, caption)), height // 2)


def panel(
    width: int, rows: int, height: int, figures: Figures, caption: tuple[str, ...]
) -> np.ndarray:
    """Return the strip below a picture of this height, uint8 [rows, width, 3]."""
    font = _font(width, height)
    image = Image.new("RGB", (width, max(rows, 1)), PAPER)
    draw, y = ImageDraw.Draw(image), font.size // 2
    for line in _lines(font, width, height, figures, caption):
        x = font.size // 2
        for item in line:
            _draw(draw, (x, y), item, font)
            x += item.room
        y += _step(font)
    return np.array(image)[:rows]


@dataclasses.dataclass(frozen=True)
class _Item:
    """Words, with an optional patch of colour before them or an optional bar below them."""

    text: str
    room: int  # pixels, with those to the next item
    colour: Any = None
    bar: float | None = None  # full at 1, or at a cost of -1
    is_round: bool = False  # the patch: a target's is, a touch's is not


def _lines(
    font: Any, width: int, height: int, figures: Figures, caption: tuple[str, ...]
) -> list[list[_Item]]:
    """Return the lines to write; terms and caption only if the scene keeps most of the picture."""
    lines = _flow(_facts(font, figures), width - font.size)
    terms = _terms(font, width, figures.terms)
    names = _flow([_item(font, text) for text in caption], width - font.size)
    for more, most in ((terms, MOST_WITH_TERMS), (names, MOST_WITH_NAMES)):
        if _height(font, lines + more) <= most * height:
            lines += more
    return lines


def _facts(font: Any, figures: Figures) -> list[_Item]:
    """Return clock, touch, distance and the legend of colours; equally long in all frames."""
    ends = [f"{level:g}" for level, _ in LEVELS[1:]]
    words = (f"< {ends[0]} N", f"{ends[0]}-{ends[1]} N", f"> {ends[1]} N")
    colours = [colour for _, colour in LEVELS]
    targets = {MEANINGS.get(name, name): _bytes(c) for name, c in figures.targets.items()}
    touch = f"touch {figures.force:.1f} N"
    said = f"says: {figures.word or '-'}"
    return [
        _item(font, figures.title, widest=f"{figures.title.split()[0]}  00.00 s  reward -000.00"),
        *([_item(font, "physics diverged: frozen")] * figures.nonfinite),
        _item(font, touch, _level(figures.force), widest="touch 000.0 N"),
        *([] if figures.word is None else [_item(font, said, widest=_LONGEST)]),
        _item(font, f"distance {100.0 * figures.distance:.0f} cm", widest="distance 000 cm"),
        *(_item(font, text, colour, is_round=True) for text, colour in targets.items()),
        *(_item(font, text, colour) for text, colour in zip(words, colours, strict=True)),
        *(_item(font, text, colour) for text, colour in (("earns", EARNS), ("costs", COSTS))),
    ]


def _terms(font: Any, width: int, terms: Mapping[str, float]) -> list[list[_Item]]:
    """Return the reward's terms with their bars, in columns."""
    room = max((_item(font, f"{name} -00.00").room for name in terms), default=1)
    columns = max(1, width // room)
    items = [
        _Item(f"{name} {round(value, 2) + 0.0:.2f}", room, bar=float(np.clip(value, -1.0, 1.0)))
        for name, value in ((name, np.nan_to_num(value)) for name, value in terms.items())
    ]
    return [items[start : start + columns] for start in range(0, len(items), columns)]


def _item(
    font: Any, text: str, colour: Any = None, widest: str = "", *, is_round: bool = False
) -> _Item:
    """Return an item with room for its widest text, a patch and a gap."""
    long = max(font.getlength(text), font.getlength(widest))
    room = round(long + font.size * (2 if colour else 1))
    return _Item(text, room, colour, is_round=is_round)


def _flow(items: list[_Item], width: int) -> list[list[_Item]]:
    """Break items into lines."""
    lines: list[list[_Item]] = []
    for item in items:
        if not lines or sum(one.room for one in lines[-1]) + item.room > width:
            lines.append([])
        lines[-1].append(item)
    return lines


def _draw(draw: ImageDraw.ImageDraw, at: tuple[int, int], item: _Item, font: Any) -> None:
    x, y = at
    size = font.size
    if item.colour is not None:
        corner = size // 2 if item.is_round else size // 8
        draw.rounded_rectangle((x, y + 0.2 * size, x + 0.8 * size, y + size), corner, item.colour)
        x += size
    draw.text((x, y), item.text, font=font, fill=INK)
    if item.bar is not None:
        top, bottom, long = y + 1.25 * size, y + 1.4 * size, item.room - size
        draw.rectangle((x, top, x + long, bottom), fill=TRACK)
        if abs(item.bar) >= 0.005:
            fill = EARNS if item.bar > 0.0 else COSTS
            draw.rectangle((x, top, x + abs(item.bar) * long, bottom), fill=fill)


def _height(font: Any, lines: list[list[_Item]]) -> int:
    return _step(font) * len(lines) + font.size


def _level(newtons: float) -> tuple[int, int, int]:
    return [colour for least, colour in LEVELS if newtons >= least or least == 0.0][-1]


def _bytes(colour: tuple[float, ...]) -> tuple[int, ...]:
    return tuple(round(255 * channel) for channel in colour[:3])


def _font(width: int, height: int) -> Any:
    """Return a font that is legible in films of 320 to 480 pixels and grows with the picture."""
    wished = max(8 + width // 80, width // 46)
    return ImageFont.load_default(max(9, min(wished, height // 14)))


def _step(font: Any) -> int:
    return round(1.5 * font.size)
