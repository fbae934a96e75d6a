"""Draws docs/images/overview.png: what this project is, in three pictures.

    python -m tools.overview ego team

A frame of a film, the partners of the split, and what robots earn with its test side. The folders
are those of `evaluate` with gentle_scratch/ppo-ego-s0-v2/robot and mappo-d1-s0-v2/robot.
"""

import json
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from zoo.registry import load_registry

IMAGES = Path(__file__).parents[1] / "docs" / "images"
TRAIN, TEST, OTHER = "#0072b2", "#e69f00", "#8a8f98"
COLUMNS = 15  # of dots, one a partner


def draw_film(axes, frame: int = 16) -> None:
    """Show the scene of a film's frame, without the bars below it."""
    with Image.open(IMAGES / "gentle_scratch.gif") as film:
        film.seek(frame)
        axes.imshow(film.convert("RGB").crop((110, 0, 430, 240)))
    axes.axis("off")
    axes.set_title("1  A robot and a human learn together", loc="left", fontsize=11)


def draw_partners(axes, train: int, test: int) -> None:
    """Draw a dot for each partner of a split, those of the training side first."""
    place = np.arange(train + test)
    colours = np.where(place < train, TRAIN, TEST)
    axes.scatter(place % COLUMNS, -(place // COLUMNS), c=list(colours), s=80)
    axes.set(xlim=(-1, COLUMNS), ylim=(-13.5, 1))
    axes.text(0, -11.4, f"{train} humans to train with", color=TRAIN, fontsize=10, weight="bold")
    axes.text(0, -12.8, f"{test} humans to test with", color="#b37700", fontsize=10, weight="bold")
    axes.axis("off")
    axes.set_title("2  The zoo keeps and splits the humans", loc="left", fontsize=11)


def draw_returns(axes, returns: dict[str, float]) -> None:
    """Draw a bar for each robot, with its return with the test partners."""
    names = list(returns)
    colours = [OTHER, OTHER, OTHER, TRAIN, OTHER]
    axes.barh(names, list(returns.values()), color=colours)
    for place, value in enumerate(returns.values()):
        axes.text(max(value, 0.0) + 6, place, f"{value:.0f}", va="center", fontsize=10)
    axes.invert_yaxis()
    axes.set_xlim(0, 420)
    axes.set_xlabel("M_test: mean return of an episode, gentle scratch", fontsize=9)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(axis="y", length=0, labelsize=10)
    axes.set_title("3  A new robot meets humans it never saw", loc="left", fontsize=11)


def main(ego: Path, team: Path) -> Path:
    """Draw the picture from two finished evaluations, and return where it is."""
    of_ego, of_team = (json.loads((x / "summary.json").read_text()) for x in (ego, team))
    split = load_registry().split("gentle_scratch")
    if {of_ego["split"]["id"], of_team["split"]["id"]} != {split.id}:
        raise ValueError(f"both folders must be of the default split, {split.id}")
    references = of_ego["references"]
    returns = {
        "does nothing": references["zero_action"]["mean"],
        "script": references["script"]["mean"],
        "learned with 1 human": of_team["m_test"]["mean"],
        f"learned with {len(split.train)}": of_ego["m_test"]["mean"],
        "each human's own robot": references["self_play"]["mean"],
    }
    figure, panes = plt.subplots(
        1, 3, figsize=(12, 3.3), width_ratios=[1.25, 1, 1.15], layout="constrained"
    )
    draw_film(panes[0])
    draw_partners(panes[1], len(split.train), len(split.test))
    draw_returns(panes[2], returns)
    path = IMAGES / "overview.png"
    figure.savefig(path, dpi=110)
    return path


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), Path(sys.argv[2])))
