"""What is written on a picture: the clock, the reward's terms as bars, force and distance."""

import dataclasses
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

INK, PAPER, BAR = (25, 30, 38, 255), (255, 255, 255, 190), (13, 148, 70, 255)


@dataclasses.dataclass(frozen=True)
class Figures:
    """What a step of one simulation says of itself."""

    title: str
    terms: dict[str, float]  # weighted reward terms
    force: float  # N
    distance: float  # m
    nonfinite: bool


def write(pixels: np.ndarray, figures: Figures, caption: tuple[str, ...] = ()) -> np.ndarray:
    """Return a copy of uint8 `pixels` [H, W, 3] with figures (upper left) and caption (lower)."""
    height, width = pixels.shape[:2]
    picture = Image.fromarray(np.ascontiguousarray(pixels))
    size = max(9, min(height // 34, width // 40))
    font = ImageFont.load_default(size)
    lines: list[tuple[str, float | None]] = [(figures.title, None)]
    lines += [(f"{name} {value:.2f}", value) for name, value in figures.terms.items()]
    lines.append(
        (f"force {figures.force:.1f} N   distance {100.0 * figures.distance:.0f} cm", None)
    )
    if figures.nonfinite:
        lines.append(("physics diverged: frozen", None))
    _panel(picture, lines, font, size, top=size // 2)
    if caption:
        bottom = height - (len(caption) * _line(size) + size + size // 2)
        _panel(picture, [(line, None) for line in caption], font, size, top=bottom)
    return np.array(picture)


def _panel(
    picture: Image.Image, lines: list[tuple[str, float | None]], font: Any, size: int, top: int
) -> None:
    """Draw lines on a translucent panel; a line with a value in [0, 1] has a bar behind it."""
    draw = ImageDraw.Draw(picture, "RGBA")
    left, pad, step = size // 2, size // 2, _line(size)
    width = round(max(draw.textlength(text, font=font) for text, _ in lines)) + 2 * pad
    draw.rectangle((left, top, left + width, top + len(lines) * step + 2 * pad), fill=PAPER)
    for i, (text, value) in enumerate(lines):
        y = top + pad + i * step
        if value is not None:
            share = float(np.clip(np.nan_to_num(value), 0.0, 1.0))
            if share > 0.0:
                draw.rectangle(
                    (left, y + step - size // 6, left + share * width, y + step), fill=BAR
                )
        draw.text((left + pad, y), text, font=font, fill=INK)


def _line(size: int) -> int:
    return round(1.4 * size)
