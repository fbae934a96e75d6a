"""Figures of the page, each drawn from a saved table by `evaluation.plots`."""

from collections.abc import Callable, Mapping
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from assistax_envs.versions import PAPER_TASKS
from evaluation.plots.charts import zsc_dots
from evaluation.plots.population import population_grid
from tools.release_page.crossplays import heatmap
from tools.release_page.paper.data import METHODS, Results
from tools.release_page.paper.panels import training_panels
from tools.release_page.paper.training import training_curves

PAGE = 7.0  # inches: letters are read at a page's width


def figures(results: Results) -> dict[str, Callable[[], Figure]]:
    """Return the drawing function of each figure that the data allow, by file name."""
    drawn: dict[str, Callable[[], Figure]] = {}
    if results.humans:
        drawn["population.png"] = lambda: _population(results)
    if results.has_curves:
        drawn["curves.png"] = lambda: _curves(results)
    for task, played in results.crossplay.items():
        drawn[f"crossplay_{task}.png"] = lambda played=played: heatmap(played)
    for task in PAPER_TASKS:
        if any((task, method) in results.egos for method in METHODS):
            drawn[f"zsc_{task}.png"] = lambda task=task: _bars(results, task)
    return drawn


def _population(results: Results) -> Figure:
    rows = [
        {"task": e.task, "algorithm": e.algorithm, "disability": e.disability}
        for e in results.humans
    ]
    caption = (
        f"n = {len(rows)} human partners of release {results.release}. "
        "Below each setting: the elbow's range and the strength that are left."
    )
    return population_grid(pl.DataFrame(rows), caption=caption, width=PAGE)


def _curves(results: Results) -> Figure:
    curves = training_curves(results)
    final = {
        task: {name: figure["iqm"] for name, figure in figures.items()}
        for task, figures in results.paper["self_play"].items()
    }
    caption = (
        f"Release {results.release}, setting d1. IQM of the training return over seeds and its "
        "pointwise 95% bootstrap band; a single seed has none. Dotted: the paper's final IQM of "
        "that algorithm (its Table 2)."
    )
    return training_panels(curves, final, caption=caption)


def _bars(results: Results, task: str) -> Figure:
    egos_of = {method.upper(): results.egos.get((task, method)) for method in METHODS}
    summaries: dict[str, Mapping[str, Any]] = {
        name: egos.summary for name, egos in egos_of.items() if egos
    }
    played = results.crossplay.get(task)
    lines = {"self-play of all teams": played.summary["self_play"]["mean"]} if played else {}
    return zsc_dots(summaries, lines)
