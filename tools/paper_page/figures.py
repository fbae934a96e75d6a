"""Figures of the page, each drawn from a saved table by `evaluation.plots`."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from assistax_envs.versions import PAPER_TASKS
from evaluation.plots.charts import zsc_dots
from evaluation.plots.heatmap import crossplay_heatmap
from evaluation.plots.matrix import arrange
from evaluation.plots.population import population_grid
from evaluation.plots.style import save_figure
from tools.paper_page.data import METHODS, CrossPlayed, Results
from tools.paper_page.panels import training_panels
from tools.paper_page.pictures import picture_names
from tools.paper_page.training import training_curves

DPI = 130  # a 198 x 198 matrix keeps more than three points a cell


def draw_figures(results: Results, folder: Path) -> list[Path]:
    """Draw every figure that the data allow; return the files, those of `picture_names`."""
    draw: dict[str, Callable[[], Figure]] = {"population.png": lambda: _population(results)}
    draw["curves.png"] = lambda: _curves(results)
    for task in PAPER_TASKS:
        draw[f"crossplay_{task}.png"] = lambda task=task: heatmap(results.crossplay[task])
        draw[f"zsc_{task}.png"] = lambda task=task: _bars(results, task)
    written = []
    for name in picture_names(results):
        save_figure(draw[name](), folder / name, DPI)
        written.append(folder / name)
    return written


def _population(results: Results) -> Figure:
    rows = [
        {"task": e.task, "algorithm": e.algorithm, "disability": e.disability}
        for e in results.humans
    ]
    caption = (
        f"n = {len(rows)} human partners of release {results.release}. "
        "Below each setting: the elbow's range and the strength that are left."
    )
    return population_grid(pl.DataFrame(rows), caption=caption)


def _curves(results: Results) -> Figure:
    curves = training_curves(results)
    final = {
        task: {name: figure["iqm"] for name, figure in found.items()}
        for task, found in results.paper["self_play"].items()
    }
    caption = (
        f"Release {results.release}, setting d1. IQM of the training return over seeds and its "
        "pointwise 95% bootstrap band; a single seed has none. Dotted: the paper's final IQM of "
        "that algorithm (its Table 2)."
    )
    return training_panels(curves, final, caption=caption)


def heatmap(played: CrossPlayed) -> Figure:
    """Draw a cross-play's clustered matrix."""
    return crossplay_heatmap(arrange(played.pairs, played.order), played.summary)


def _bars(results: Results, task: str) -> Figure:
    found = {method.upper(): results.egos.get((task, method)) for method in METHODS}
    summaries: dict[str, Mapping[str, Any]] = {
        name: egos.summary for name, egos in found.items() if egos
    }
    played = results.crossplay.get(task)
    lines = {"self-play of all teams": played.summary["self_play"]["mean"]} if played else {}
    return zsc_dots(summaries, lines)
