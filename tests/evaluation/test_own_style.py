"""Figures under any settings of Matplotlib: equal bytes, and the user's settings stay."""

import ast
import os
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib
import polars as pl
import pytest
from matplotlib.figure import Figure

from evaluation.plots.charts import performance_profile, trait_points, zsc_dots
from evaluation.plots.league import league_chart
from evaluation.plots.population import population_grid
from evaluation.plots.style import figure_bytes, own_style, save_figure
from tests.evaluation.episode_tables import teams
from tests.evaluation.test_plots import ROOT, bars, draw, speeds, training
from tools.league.figures import failure_chart, validation_curves

# What a matplotlibrc may say; none of it is read while we draw.
UGLY: dict[str, Any] = {
    "text.usetex": True,
    "font.family": "monospace",
    "font.size": 17.0,
    "axes.facecolor": "black",
    "axes.grid": True,
    "axes.prop_cycle": "cycler('color', ['ff00ff', '00ff00'])",
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.unicode_minus": False,
    "errorbar.capsize": 9.0,
    "figure.autolayout": True,
    "figure.dpi": 41.0,
    "image.cmap": "hot",
    "image.interpolation": "bicubic",
    "lines.linewidth": 5.5,
    "lines.markersize": 11.0,
    "patch.force_edgecolor": True,
    "path.sketch": (3.0, 40.0, 5.0),
    "pdf.compression": 0,
    "pdf.fonttype": 3,
    "savefig.bbox": "tight",
    "savefig.facecolor": "red",
    "savefig.transparent": True,
    "svg.fonttype": "path",
    "text.color": "orange",
    "xtick.direction": "in",
    "xtick.minor.visible": True,
    "ytick.labelsize": 3.0,
}
CURVE = pl.DataFrame({"row": ["ppo"], "steps": [1e6], "iqm": [5.0], "low": [4.0], "high": [6.0]})
PROFILE = pl.DataFrame(
    {"threshold": [0.0, 1.0], "share": [1.0, 0.0], "low": [0.9, 0.0], "high": [1.0, 0.1]}
)
LEAGUE = pl.DataFrame({"row": ["ppo"], "mean": [3.0], "low": [2.0], "high": [4.0]})
COUNTS = pl.DataFrame(
    [("scratch", "ippo", "d1")] * 3, schema=["task", "algorithm", "disability"], orient="row"
)
FIGURES: dict[str, Callable[[], Figure]] = {
    "matrix": lambda: draw(teams(6, ("ippo", "isac"), ("d1", "d9")))[1],
    "dots": partial(bars, zsc_dots),
    "traits": partial(bars, trait_points),
    "profile": lambda: performance_profile({"ppo": PROFILE}, task="scratch", caption="n"),
    "speeds": speeds,
    "panels": partial(training, 2),
    "population": lambda: population_grid(COUNTS, caption="n"),
    "league": lambda: league_chart({"scratch": LEAGUE}),
}


@pytest.mark.slow_for("matrix", "dots", "traits", "panels")
@pytest.mark.parametrize("kind", FIGURES)
def test_any_matplotlibrc_gives_equal_bytes(kind: str) -> None:
    def drawn() -> list[bytes]:
        return [figure_bytes(FIGURES[kind](), ending, 50) for ending in (".svg", ".png")]

    expected = drawn()
    with matplotlib.rc_context(UGLY):
        assert drawn() == expected


def test_a_setting_that_gets_through_is_seen() -> None:
    """A figure whose maker forgets `own_style` has other bytes."""
    bare = vars(zsc_dots)["__wrapped__"]
    expected = figure_bytes(bars(bare), ".svg", 50)
    with matplotlib.rc_context({"axes.facecolor": "black"}):
        assert figure_bytes(bars(bare), ".svg", 50) != expected


def test_the_users_settings_stay(tmp_path: Path) -> None:
    with matplotlib.rc_context(UGLY):
        before = dict(matplotlib.rcParams)
        figure = save_figure(FIGURES["dots"](), tmp_path / "dots.png", bare=True)
        assert dict(matplotlib.rcParams) == before
        with pytest.raises(ZeroDivisionError), own_style():
            assert dict(matplotlib.rcParams) != before
            raise ZeroDivisionError
        assert dict(matplotlib.rcParams) == before
    figure.axes[0].set_title("mine")
    figure.savefig(tmp_path / "mine.pdf")  # what is returned can be saved again
    assert (tmp_path / "mine.pdf").stat().st_size > 1000


def makers() -> list[tuple[Path, ast.FunctionDef, set[str]]]:
    """Return the functions that make a figure, with their decorators."""
    folders = ("evaluation", "tools", "workshop/assistax_workshop")
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    found = []
    for path in paths:
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name != "titled_figure":
                calls = {ast.unparse(n.func) for n in ast.walk(node) if isinstance(n, ast.Call)}
                if calls & {"style.titled_figure", "titled_figure", "plt.subplots", "Figure"}:
                    found.append((path, node, {ast.unparse(d) for d in node.decorator_list}))
    return found


def test_each_public_maker_draws_in_our_style() -> None:
    found = makers()
    assert len(found) >= 7
    for path, node, decorators in found:
        own = decorators & {"style.own_style()", "own_style()"}
        assert own or node.name.startswith("_") or node.name == "panels_of", (path, node.name)
    for maker in (failure_chart, validation_curves):  # they draw in panels that they share
        assert hasattr(maker, "__wrapped__")


def test_importing_changes_no_setting(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_text("font.size: 17\n")
    code = (
        "import matplotlib\nbefore = dict(matplotlib.rcParams)\n"
        "import assistax_zoo.results, evaluation.plots.figures, evaluation.report.page\n"
        "assert dict(matplotlib.rcParams) == before and before['font.size'] == 17"
    )
    settings = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=settings, check=True)
