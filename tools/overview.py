"""Draws docs/images/overview.png: what this project is, in three pictures.

    python -m tools.overview

A moment of docs/images/gentle_scratch.png, the partners of release v2's default split, and what
robots earned with its test side: the figures of docs/log/results-v2.md.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import polars as pl
from PIL import Image

from assistax_base.parquet import read_parquet
from evaluation.plots.style import own_style
from zoo.registry import load_registry

DOCS = Path(__file__).parents[1] / "docs"
IMAGES = DOCS / "images"
TRAIN, TEST, OTHER = "#0072b2", "#e69f00", "#8a8f98"
COLUMNS = 15  # of dots, one a partner


def draw_moment(axes) -> None:
    """Show the scene of the picture's second moment, without the words below it."""
    with Image.open(IMAGES / "gentle_scratch.png") as moments:
        axes.imshow(moments.convert("RGB").crop((425, 5, 650, 202)))
    axes.axis("off")
    axes.set_title("1  A robot and a human learn together", loc="left", fontsize=11)


def draw_partners(axes, train: int, test: int) -> None:
    """Draw a dot for each partner of a split, those of the training side first."""
    place = np.arange(train + test)
    colours = np.where(place < train, TRAIN, TEST)
    axes.scatter(place % COLUMNS, -(place // COLUMNS), c=list(colours), s=80)
    axes.set(xlim=(-1, COLUMNS), ylim=(-13.5, 1))
    axes.text(0, -11.4, f"{train} humans to train with", color=TRAIN, fontsize=11, weight="bold")
    axes.text(0, -12.8, f"{test} humans to test with", color="#b37700", fontsize=11, weight="bold")
    axes.axis("off")
    axes.set_title("2  The zoo keeps and splits the humans", loc="left", fontsize=11)


def m_test(method: Path) -> float:
    """Return the mean return of a method's robots with the partners of the test side."""
    test = read_parquet(method / "pairs.parquet").filter(pl.col("side") == "test")
    return test.select(
        (pl.col("return") * pl.col("episodes")).sum() / pl.col("episodes").sum()
    ).item()


def draw_returns(axes, returns: dict[str, float]) -> None:
    """Draw a bar for each kind of robot, with its return with the test partners."""
    colours = [OTHER, OTHER, TRAIN, "white"]
    edges = [OTHER, OTHER, TRAIN, TEST]
    bars = axes.barh(list(returns), list(returns.values()), color=colours, edgecolor=edges)
    bars[-1].set_hatch("///")  # these robots have met the test partners
    for place, value in enumerate(returns.values()):
        axes.text(max(value, 0.0) + 6, place, f"{value:.0f}", va="center", fontsize=11)
    axes.invert_yaxis()
    axes.set_xlim(-5, 340)
    axes.set_xlabel("mean return with the 40, gentle scratch", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(axis="y", length=0, labelsize=11)
    axes.set_title("3  New robots meet the test humans", loc="left", fontsize=11)


@own_style()
def main() -> Path:
    """Draw the picture and return where it is."""
    split = load_registry().split("gentle_scratch")
    robots = DOCS / "data/v2/egos" / split.id
    returns = {
        "acts at random": m_test(robots / "random"),
        "script": m_test(robots / "script"),
        f"learned with\nthe {len(split.train)}": m_test(robots / "ppo"),
        f"learned with\nthe {len(split.test)} themselves": m_test(robots / "ppo-mirror"),
    }
    figure, panes = plt.subplots(
        1, 3, figsize=(11.5, 3.3), width_ratios=[1.15, 1, 1.3], layout="constrained"
    )
    draw_moment(panes[0])
    draw_partners(panes[1], len(split.train), len(split.test))
    draw_returns(panes[2], returns)
    path = IMAGES / "overview.png"
    figure.savefig(path, dpi=110)
    with Image.open(path) as drawn:
        drawn.convert("RGB").quantize(256, Image.Quantize.FASTOCTREE).save(path, optimize=True)
    return path


if __name__ == "__main__":
    print(main())
