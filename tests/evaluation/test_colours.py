"""Colours that stand side by side are told apart, for every vision and in grey."""

import itertools
import re
from collections.abc import Iterable
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_rgb

from evaluation.figures.league import KNOWING, KNOWING_MEMORY, KNOWING_NUMBERS, MIRROR
from evaluation.plots import style
from population.method_presets import METHODS

ROOT = Path(__file__).parents[2]
# Machado et al. (2009), full severity, on linear RGB.
COLOUR_VISION = {
    "normal": np.eye(3),
    "deuteranopia": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "protanopia": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
    "tritanopia": [[1.256, -0.077, -0.179], [-0.078, 0.931, 0.148], [0.005, 0.691, 0.304]],
}
XYZ = np.array([[0.4125, 0.3576, 0.1804], [0.2127, 0.7152, 0.0722], [0.0193, 0.1192, 0.9503]])
SETTINGS = style.disability_colours([f"d{i}" for i in range(1, 10)])
LEVELS = {
    name: [style.level_colour(name, level) for level in (1.0, 0.7, 0.4)]
    for name in ("strength", "range")
}
OURS = style.algorithm_colours(["ippo", "isac", "mappo", "masac", "mep"])
OTHERS = style.algorithm_colours(["e", "f", "g", "h"])
# Rows whose learning curves usually stand in one figure.
KNOWN = KNOWING, KNOWING_MEMORY, KNOWING_NUMBERS, MIRROR
ROWS = style.algorithm_colours(["ppo", "sac", "dagger", *METHODS, *KNOWN])
MAP = matplotlib.colormaps[style.COLOUR_MAP](np.linspace(0, 1, 64))[:, :3]
CLEAR, SEEN = 15.0, 8.0  # CIEDE2000: of two colours for full vision, and for any vision
APART = 6.5  # of two strips, which their places tell apart too


def lab(colours: Iterable[object], vision: str = "normal") -> np.ndarray:
    """Return CIE Lab [N, 3] of colours as seen with a vision."""
    rgb = np.array([to_rgb(colour) for colour in colours])
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    xyz = np.clip(linear @ np.array(COLOUR_VISION[vision]).T, 0, 1) @ XYZ.T / [0.9505, 1.0, 1.0888]
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    x, y, z = f.T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def ciede2000(first: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the distance of colours in Lab (Sharma, Wu and Dalal, 2005)."""
    (l1, a1, b1), (l2, a2, b2) = np.moveaxis(first, -1, 0), np.moveaxis(other, -1, 0)
    mean = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    grown = 1.5 - 0.5 * np.sqrt(mean**7 / (mean**7 + 25.0**7))
    c1, c2 = np.hypot(grown * a1, b1), np.hypot(grown * a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, grown * a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = np.where(c1 * c2 == 0, 0.0, (h2 - h1 + 180) % 360 - 180)
    hue = np.where(c1 * c2 == 0, h1 + h2, (h1 + turn / 2) % 360)
    lightness, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    turns = ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.20, 4, -63))
    t = 1 + sum(size * np.cos(np.radians(times * hue + by)) for size, times, by in turns)
    away = (lightness - 50) ** 2
    dl = (l2 - l1) / (1 + 0.015 * away / np.sqrt(20 + away))
    dc = (c2 - c1) / (1 + 0.045 * chroma)
    dh = 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2)) / (1 + 0.015 * chroma * t)
    blue = np.sin(np.radians(60 * np.exp(-(((hue - 275) / 25) ** 2))))
    mixed = -2 * blue * np.sqrt(chroma**7 / (chroma**7 + 25.0**7))
    return np.sqrt(dl**2 + dc**2 + dh**2 + mixed * dc * dh)


def closest(colours: Iterable[object], others: Iterable[object], vision: str = "normal") -> float:
    """Return the least distance of two colours, one of each list."""
    return float(ciede2000(lab(colours, vision)[:, None], lab(others, vision)[None]).min())


@pytest.mark.parametrize(
    ("first", "other", "distance"),
    [
        ([50, 2.6772, -79.7751], [50, 0, -82.7485], 2.0425),
        ([50, -1, 2], [50, 0, 0], 2.3669),
        ([50, 2.5, 0], [50, 0, -2.5], 4.3065),
        ([50, 2.5, 0], [58, 24, 15], 19.4535),
        ([2.0776, 0.0795, -1.135], [0.9033, -0.0636, -0.5514], 0.9082),
    ],
)
def test_colour_distance_matches_published_values(first: list, other: list, distance: float):
    measured = ciede2000(np.array(first, float), np.array(other, float))
    assert float(measured) == pytest.approx(distance, abs=1e-4)


@pytest.mark.parametrize("vision", COLOUR_VISION)
def test_strip_colours_differ(vision: str):
    least = CLEAR if vision == "normal" else SEEN
    for strip in (OURS, SETTINGS, ROWS):
        for (one, first), (two, other) in itertools.combinations(strip.items(), 2):
            assert closest([first], [other], vision) > least, (one, two)
    for colours in LEVELS.values():
        for first, other in itertools.combinations(colours, 2):
            assert closest([first], [other], vision) > CLEAR
        assert closest(OURS.values(), colours, vision) > APART
        assert closest(colours, MAP, vision) > 5.0
    assert closest(LEVELS["strength"], LEVELS["range"], vision) > APART
    assert closest(OURS.values(), MAP, vision) > 5.0


@pytest.mark.parametrize("vision", COLOUR_VISION)
def test_other_methods_differ_from_ours_and_among_themselves(vision: str):
    rows = {name: colour for name, colour in ROWS.items() if name not in style.ALGORITHMS}
    for first, other in itertools.combinations(OTHERS.values(), 2):
        assert closest([first], [other], vision) > SEEN
    assert closest(OTHERS.values(), rows.values(), vision) > SEEN
    for colours in (OTHERS, rows):
        assert closest(colours.values(), OURS.values(), vision) > SEEN


@pytest.mark.parametrize(
    ("algorithm", "setting"),
    [("#690f00", "#690000"), ("#1e0ff0", "#5a4bff"), ("#e17800", "#ff7800")],
)
def test_planted_defect_similar_colours_are_caught(algorithm: str, setting: str):
    assert closest([algorithm], [setting]) < CLEAR


def test_strips_differ_in_grey():
    families = list(OTHERS.values())[:3]  # of persons
    for strip, step in ((OURS.values(), 9.0), (SETTINGS.values(), 5.0), (families, 9.0)):
        assert min(np.diff(np.sort(lab(strip)[:, 0]))) > step
    for colours in LEVELS.values():  # one hue, lighter as less is left
        lightness, a, b = lab(colours).T
        assert min(np.diff(lightness)) > 20
        hues = np.degrees(np.arctan2(b, a))
        assert np.ptp(hues) < 25


def test_no_colour_of_a_strip_is_nearly_black():
    strips = [*OURS.values(), *SETTINGS.values(), *LEVELS["strength"], *LEVELS["range"]]
    assert lab(strips)[:, 0].min() > 30


def test_planted_defect_nearly_black_is_caught():
    assert lab(["#331100", "#000033", "#002222"])[:, 0].max() < 30


def test_settings_are_lighter_as_strength_falls():
    for first in (1, 4, 7):  # lighter as strength falls
        lightness = lab(SETTINGS[f"d{i}"] for i in range(first, first + 3))[:, 0]
        assert min(lightness[1:] - lightness[0]) > 12


def test_algorithm_colour_is_constant():
    for names in (["masac"], ["ippo", "masac"], ["a", "masac", "z"]):
        assert style.algorithm_colours(names)["masac"] == style.ALGORITHMS["masac"]
    assert style.algorithm_colours(["PPO"])["PPO"] == style.ALGORITHMS["ippo"]
    known = {*style.ALGORITHMS.values(), *style.ROWS.values(), *SETTINGS.values()}
    known |= {colour for colours in LEVELS.values() for colour in colours}
    for folder in ("evaluation", "assistax_zoo", "tools"):
        for path in (ROOT / folder).rglob("*.py"):
            named = re.findall(r"#[0-9a-fA-F]{6}", path.read_text(encoding="utf-8"))
            assert path.name == "style.py" or not known & set(named), path


def test_unknown_settings_get_colours():
    colours = style.disability_colours(["d1", "tremor-2", None, "tremor-1"])
    assert list(colours) == ["d1", "tremor-1", "tremor-2"]
    assert len(set(colours.values())) == 3
