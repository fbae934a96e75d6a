"""Figures from saved tables: a plot evaluates nothing."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from assistax_zoo.commands.options import Page
from zoo.registry import load_registry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OrderName = Literal["shared", "separate"]
LegendName = Literal["beside", "below", "none"]


def crossplay(
    folder: Path,
    /,
    *,
    out: Path,
    order: OrderName | None = None,
    legend: LegendName | None = None,
    page: Page = Page(),
) -> None:
    """Draw the clustered cross-play matrix that `crossplay` saved.

    Robots and humans are ordered by average linkage with optimal leaf order. With the same teams on
    both axes they share one order, and self-play is the diagonal.

    Args:
        folder: Folder that `assistax-zoo crossplay --out` filled.
        out: Figure to write, .png, .pdf or .svg.
        order: shared for one order of teams on both axes, or separate for one order each; default
            shared if possible.
        legend: Place of the legend: beside or below the matrix, or none; default by the room that
            there is, and none with --bare.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot crossplay xp --width 3.3 --out crossplay.pdf
    """
    from evaluation.plots.figures import crossplay_figure

    _tell(crossplay_figure(folder, out, order, legend=legend, **page.given()), out, page)


def zsc(folders: tuple[Path, ...], /, *, out: Path, page: Page = Page()) -> None:
    """Draw the returns of methods with training and test partners, with 95% intervals.

    Several folders are compared on the partners that all of them have in common, without those that
    a robot of any of them met in training. Lines are the references of each folder; a name such as
    `script 300 to 420` says that they differ.

    Args:
        folders: Folders that `assistax-zoo evaluate --split both --out` filled, one for each
            method; the figure shows their names.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot zsc results/ppo results/fcp --out zsc.pdf
    """
    _draw(folders, "zsc", out, page)


def disability(folders: tuple[Path, ...], /, *, out: Path, page: Page = Page()) -> None:
    """Draw the returns of methods with the partners of each disability setting, with 95% intervals.

    Args:
        folders: Folders that `assistax-zoo evaluate --out` filled, one for each method; the figure
            shows their names.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot disability results/ppo --out disability.png
    """
    _draw(folders, "disability", out, page)


def preference(folders: tuple[Path, ...], /, *, out: Path, page: Page = Page()) -> None:
    """Draw the returns of methods on a gentle task by the humans' preferences, with 95% intervals.

    Args:
        folders: Folders that `assistax-zoo evaluate --out` filled, one for each method; the figure
            shows their names.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot preference results/ppo --out preference.png
    """
    _draw(folders, "preference", out, page)


def adaptation(folder: Path, /, *, out: Path, page: Page = Page()) -> None:
    """Draw done values of each wish beside the liked ones, a point for each person.

    There is a panel for each wish of the gentle task. A robot that listens follows the diagonal;
    one that plays for the average person draws a flat line.

    Args:
        folder: Folder that `assistax-zoo evaluate --out` filled, with persons as partners.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot adaptation results/ego --out adaptation.png
    """
    from evaluation.plots.figures import adaptation_figure

    _tell(adaptation_figure(folder, out, **page.given()), out, page)


def profile(folders: tuple[Path, ...], /, *, out: Path, page: Page = Page()) -> None:
    """Draw performance profiles: the share of robot-partner pairs above each return.

    Args:
        folders: Folders that `assistax-zoo evaluate --out` filled, one for each method; the figure
            shows their names.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot profile results/ppo results/fcp --out profile.pdf
    """
    _draw(folders, "profile", out, page)


def curves(run: Path, /, *, out: Path, page: Page = Page()) -> None:
    """Draw a training run's learning curves: IQM over seeds with 95% bands, a line a setting.

    Args:
        run: Folder that `assistax-zoo train --out` filled, or is filling.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot curves runs/scratch-ippo --out curves.pdf
    """
    from evaluation.plots.figures import curves_figure

    _tell(curves_figure(run, out, **page.given()), out, page)


def speed(measured: tuple[Path, ...], /, *, out: Path, page: Page = Page()) -> None:
    """Draw environment steps per second against the batch size.

    Args:
        measured: Files with what `python -m benchmarks env --json` printed.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot speed native.json warp.json --out speed.png
    """
    from evaluation.plots.figures import speed_figure

    _tell(speed_figure(measured, out, **page.given()), out, page)


def sweep(folder: Path, /, *, out: Path, page: Page = Page()) -> None:
    """Draw a sweep: the final return over each hyperparameter, the best configuration marked.

    Args:
        folder: Folder that `assistax-zoo sweep --out` filled.
        out: Figure to write, .png, .pdf or .svg.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot sweep sweeps/ippo --out sweep.pdf
    """
    from evaluation.plots.figures import sweep_figure

    _tell(sweep_figure(folder, out, **page.given()), out, page)


def population(
    *,
    out: Path,
    task: str | None = None,
    release: str | None = None,
    registry: Path | None = None,
    page: Page = Page(),
) -> None:
    """Draw the published partners as a grid of algorithms and disability settings.

    Args:
        out: Figure to write, .png, .pdf or .svg.
        task: Only this task.
        release: Only this release, such as v1.
        registry: Registry to read instead of the installed one.
        page: Its width, and whether title and caption are left out.

    Example:
        assistax-zoo plot population --out population.png
    """
    from evaluation.plots.figures import population_figure

    entries = load_registry(registry).select(task=task, role="human", release=release)
    _tell(population_figure(entries, out, **page.given()), out, page)


def _draw(folders: Sequence[Path], kind: str, out: Path, page: Page) -> None:
    from evaluation.plots.figures import evaluation_figure

    _tell(evaluation_figure(folders, kind, out, **page.given()), out, page)


def _tell(figure: "Figure", out: Path, page: Page) -> None:
    """Print a figure's file; of a bare one also title and caption, which the file lacks."""
    from evaluation.plots.style import words

    print(out)
    if page.bare:
        print(words(figure))
