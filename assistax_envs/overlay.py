"""What stands below a picture: clock, reward terms as bars, force, and what the colours mean."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

INK, PAPER, TRACK = (25, 30, 38), (250, 250, 251), (222, 226, 231)
EARNS, COSTS = (70, 82, 100), (128, 90, 190)
# N, and the colour from there on: below a gentle touch, above it, more than a frail person bears.
LEVELS = ((0.0, (0, 158, 115)), (10.0, (240, 180, 0)), (65.0, (204, 60, 0)))
MEANINGS = {
    "ends": "ends of the stroke",
    "next": "next to wipe",
    "section": "where to hold the arm",
    "waist": "where the arm goes",
}  # of targets' names
SMALLEST = 100  # pixels: what is lower has no room for words


@dataclasses.dataclass(frozen=True)
class Figures:
    """What a step of one simulation says of itself."""

    title: str
    terms: dict[str, float]  # weighted reward terms
    force: float  # N
    distance: float  # m
    nonfinite: bool
    targets: Mapping[str, tuple[float, ...]]  # colours, RGBA


def force_colour(newtons: float) -> tuple[float, ...]:
    """Return the colour of a force, RGBA."""
    return (*(channel / 255 for channel in _level(newtons)), 1.0)


def panel_height(width: int, height: int, figures: Figures, caption: tuple[str, ...]) -> int:
    """Return how many of a picture's lines of pixels the words take, 0 where there is no room."""
    if height < SMALLEST:
        return 0
    size = _size(width, height)
    rows = -(-len(figures.terms) // _columns(width, size)) + len(_lines(width, size, figures))
    return min(_step(size) * (1 + rows + len(_captions(width, size, caption))) + size, height // 2)


def panel(
    width: int, rows: int, height: int, figures: Figures, caption: tuple[str, ...]
) -> np.ndarray:
    """Return what stands below a picture of this height, uint8 [rows, width, 3]."""
    size = _size(width, height)
    font, step, pad = ImageFont.load_default(size), _step(size), size // 2
    image = Image.new("RGB", (width, max(rows, 1)), PAPER)
    draw = ImageDraw.Draw(image)
    title = f"{figures.title}{'   physics diverged: frozen' * figures.nonfinite}"
    draw.text((pad, pad), title, font=font, fill=INK)
    y = pad + step
    columns = _columns(width, size)
    for i, (name, value) in enumerate(figures.terms.items()):
        left = pad + i % columns * ((width - pad) // columns)
        _bar(draw, (left, y + i // columns * step), name, value, font)
    y += -(-len(figures.terms) // columns) * step
    for line in _lines(width, size, figures):
        x = float(pad)
        for colour, text in line:
            x = _item(draw, (x, y), colour, text, font)
        y += step
    for line in _captions(width, size, caption):
        draw.text((pad, y), line, font=font, fill=INK)
        y += step
    return np.array(image)[:rows]


def _lines(width: int, size: int, figures: Figures) -> list[list[tuple[Any, str]]]:
    """Return lines of a coloured patch, or None, and words: what is felt, and what colours mean."""
    ends = [f"{level:.0f}" for level, _ in LEVELS[1:]]
    words = (f"< {ends[0]} N", f"{ends[0]}-{ends[1]} N", f"> {ends[1]} N")
    items: list[tuple[Any, str]] = [
        (_level(figures.force), f"touch {figures.force:5.1f} N"),
        (None, f"distance {100.0 * figures.distance:3.0f} cm"),
        (None, "targets:"),
        *((_bytes(colour), MEANINGS.get(name, name)) for name, colour in figures.targets.items()),
        (None, "touches, larger with force:"),
        *((colour, text) for (_, colour), text in zip(LEVELS, words, strict=True)),
        (EARNS, "earns"),
        (COSTS, "costs"),
    ]
    font, lines, room = ImageFont.load_default(size), [[]], width - size
    for item in items:
        long = font.getlength("touch 000.0 N" if item[1].startswith("touch ") else item[1])
        if room < long + 2 * size:
            lines.append([])
            room = width - size
        lines[-1].append(item)
        room -= round(long + 2 * size)
    return lines


def _item(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], colour: Any, text: str, font: Any
) -> float:
    """Write words behind their patch; return where the next ones begin."""
    x, y = at
    size = font.size
    if colour is not None:
        draw.rounded_rectangle((x, y + 0.2 * size, x + 0.8 * size, y + size), size // 4, colour)
        x += size
    draw.text((x, y), text, font=font, fill=INK)
    return x + draw.textlength(text, font=font) + size


def _bar(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], name: str, value: float, font: Any
) -> None:
    """Write a term above a track that is full at 1, or at a cost of 1."""
    x, y = at
    size = font.size
    draw.text((x, y), f"{name} {round(value, 2) + 0.0:.2f}", font=font, fill=INK)
    share = float(np.clip(np.nan_to_num(value), -1.0, 1.0))
    top, long = y + 1.25 * size, 9.0 * size
    draw.rectangle((x, top, x + long, top + size / 6), fill=TRACK)
    if abs(share) >= 0.005:
        fill = EARNS if share > 0.0 else COSTS
        draw.rectangle((x, top, x + abs(share) * long, top + size / 6), fill=fill)


def _captions(width: int, size: int, caption: tuple[str, ...]) -> list[str]:
    """Return the caption in one line where it fits."""
    joined = "   ".join(caption)
    fits = ImageFont.load_default(size).getlength(joined) <= width - size
    return [joined] * bool(caption) if fits else list(caption)


def _level(newtons: float) -> tuple[int, int, int]:
    return [colour for least, colour in LEVELS if newtons >= least or least == 0.0][-1]


def _bytes(colour: tuple[float, ...]) -> tuple[int, ...]:
    return tuple(round(255 * channel) for channel in colour[:3])


def _columns(width: int, size: int) -> int:
    return max(1, width // round(10.2 * size))


def _size(width: int, height: int) -> int:
    return max(9, min(height // 32, width // 46))


def _step(size: int) -> int:
    return round(1.5 * size)
