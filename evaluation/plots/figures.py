"""Figures of finished folders: read the saved tables, draw them, write the file."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from assistax_base.bounded_reading import parse_json
from evaluation.figures.comparable import method_figures
from evaluation.figures.metrics import curves
from evaluation.figures.metrics.caring import adaptations, persons_done
from evaluation.figures.summary import EvaluationSummary, read_summary
from evaluation.plots import charts
from evaluation.plots.adaptation import adaptation_panels
from evaluation.plots.captions import provenance
from evaluation.plots.crossplay.heatmap import crossplay_heatmap
from evaluation.plots.crossplay.layout import LegendPlace
from evaluation.plots.crossplay.matrix import Order, arrange
from evaluation.plots.persons import described_panels
from evaluation.plots.population import population_grid
from evaluation.plots.style import check_path, save_figure, spelled
from evaluation.plots.sweep import sweep_panels
from evaluation.record import tables
from evaluation.record.record import Record
from evaluation.record.verification import check_whole, strange_tables_refused


def evaluation_figure(
    folders: Sequence[Path],
    kind: str,
    path: Path,
    *,
    width: float | None = None,
    bare: bool = False,
) -> Figure:
    """Draw evaluations, one for each method, named as their folders, and write the figure.

    Args:
        folders: Folders of `evaluate`.
        kind: "zsc", "disability", "preference" or "profile".
        path: File to write.
        width: Width of the figure, in inches.
        bare: Whether to leave out title and caption.

    Raises:
        ValueError: A folder has other content, or two folders have the same name.
    """
    check_path(path)
    if not folders:
        raise ValueError("there is no folder to draw; name at least one evaluation's")
    methods: dict[str, Path] = {}
    for folder in folders:
        name = folder.resolve().name
        if name in methods:
            raise ValueError(
                f"two folders are named {name}; rename one, because the figure labels methods by it"
            )
        _require(folder, "evaluate", tables.SUMMARY_FILE, tables.PROFILE_FILE)
        methods[name] = folder
    figures = method_figures(methods, profiles=kind == "profile")
    shown = {name: tables.to_json(summary) for name, summary in figures.summaries.items()}
    note = "".join(f"\n{text}" for text in figures.about)
    if kind == "profile":
        drawn = charts.performance_profile(
            figures.profiles,
            task=" and ".join(sorted({summary["task"] for summary in shown.values()})),
            caption=f"Bands: pointwise 95% bootstrap.\n{provenance(shown)}{note}",
            width=width,
        )
    else:
        drawn = (
            charts.zsc_dots(shown, width=width, note=note)
            if kind == "zsc"
            else charts.trait_points(shown, kind, width=width, note=note)
        )
    return save_figure(drawn, path, bare=bare)


def adaptation_figure(
    folder: Path, path: Path, *, width: float | None = None, bare: bool = False
) -> Figure:
    """Draw what the robots of an evaluation did beside what persons like, to a file.

    Raises:
        ValueError: The folder has other content, or its episodes do not measure wishes.
    """
    check_path(path)
    _require(folder, "evaluate", tables.SUMMARY_FILE, tables.EPISODES_FILE)
    with strange_tables_refused(folder):
        drawn = adaptation_of(folder, width=width)
    return save_figure(drawn, path, bare=bare)


def adaptation_of(folder: Path, *, width: float | None = None) -> Figure:
    """Return the figure of a folder's adaptation, `width` inches wide."""
    summary = read_summary(folder)
    if not isinstance(summary, EvaluationSummary):
        raise ValueError(f"{folder} holds a cross-play; this figure is of an evaluation")
    left_out = summary.met.left_out if summary.met else ()
    returns = Record.read(folder).without(left_out).returns.evaluated_side
    return adaptation_panels(
        persons_done(returns),
        adaptations(returns),
        title=f"Adaptation: {summary.task}, {summary.side} partners",
        caption=provenance({folder.resolve().name: tables.to_json(summary)}),
        width=width,
    )


def persons_figure(summary: Mapping[str, Any], path: Path) -> Figure:
    """Draw the effects of persons' numbers, a result of `summarise_parameters`, to a file."""
    return save_figure(described_panels(summary), path)


def crossplay_figure(
    folder: Path,
    path: Path,
    order: Order | None = None,
    *,
    width: float | None = None,
    bare: bool = False,
    legend: LegendPlace | None = None,
) -> Figure:
    """Draw the clustered matrix of a cross-play, `width` inches wide, to a file.

    A bare one has no title and caption, and no legend unless its place is given. The order is
    computed from the pairs, not read from the file of the order.

    Raises:
        ValueError: The folder has other content, or the axes have no shared order.
    """
    check_path(path)
    _require(folder, "crossplay", tables.SUMMARY_FILE, tables.PAIRS_FILE)
    with strange_tables_refused(folder):
        matrix = arrange(tables.read_parquet(folder / tables.PAIRS_FILE), order)
        summary = tables.to_json(read_summary(folder))
        place = legend or ("none" if bare else None)
        drawn = crossplay_heatmap(matrix, summary, width=width, legend=place)
    return save_figure(drawn, path, bare=bare)


def curves_figure(
    run: Path, path: Path, *, width: float | None = None, bare: bool = False
) -> Figure:
    """Draw the learning curves of a finished or running folder of `train`."""
    check_path(path)
    _require(run, "train", "metrics.parquet", "config.json")
    table = curves.learning_curves(tables.read_parquet(run / "metrics.parquet"))
    config = tables.read_json(run / "config.json")["config"]
    counts = table.select("disability", "seeds").unique().sort("disability")
    seeds = ", ".join(f"{name} {n}" for name, n in counts.rows())
    figure = charts.learning_curves(
        table,
        title=f"Training: {config['task']}, {spelled(config.get('algorithm', 'ippo'))}",
        caption="IQM of the return over seeds and its pointwise 95% bootstrap band. "
        f"Seeds: {seeds}.",
        width=width,
    )
    return save_figure(figure, path, bare=bare)


def sweep_figure(
    folder: Path, path: Path, *, width: float | None = None, bare: bool = False
) -> Figure:
    """Draw the final returns of a folder that `sweep` filled over each hyperparameter."""
    check_path(path)
    _require(folder, "sweep", "sweep.parquet", "preset.json")
    results = tables.read_parquet(folder / "sweep.parquet")
    caption = (
        f"{results['configuration'].n_unique()} configurations x {results['seed'].n_unique()} "
        f"seeds, {results['diverged'].sum()} runs diverged and are not drawn. Circles: the "
        "configuration with the best mean."
    )
    figure = sweep_panels(
        results,
        title=f"Sweep: {spelled(tables.read_json(folder / 'preset.json')['algorithm'])}",
        caption=caption,
        width=width,
    )
    return save_figure(figure, path, bare=bare)


def speed_figure(
    measured: Sequence[Path], path: Path, *, width: float | None = None, bare: bool = False
) -> Figure:
    """Draw the measurements in one or more outputs of `python -m benchmarks env --json`."""
    check_path(path)
    printed = "`python -m benchmarks env` printed as JSON"
    if not measured:
        raise ValueError(f"no file was given; give one or more that {printed}")
    names = ("task", "backend", "device", "batch", "env_steps_per_second")
    rows = [row for file in measured for row in parse_json(file.read_text(encoding="utf-8"))]
    if bad := [row for row in rows if not isinstance(row, dict) or set(names) - set(row)]:
        raise ValueError(f"{bad[0]!r} is not a row that {printed}; it needs {', '.join(names)}")
    table = pl.DataFrame([{name: row[name] for name in names} for row in rows])
    caption = "Random actions; the median of three repeats, compilation not counted."
    return save_figure(charts.speed(table, caption=caption, width=width), path, bare=bare)


def population_figure(
    partners: Iterable[Any], path: Path, *, width: float | None = None, bare: bool = False
) -> Figure:
    """Draw partners, entries of a registry, as a grid of algorithms and disability settings."""
    check_path(path)
    entries = list(partners)
    rows = [{"task": e.task, "algorithm": e.algorithm, "disability": e.disability} for e in entries]
    releases = ", ".join(sorted({entry.release for entry in entries}))
    caption = (
        f"n = {len(entries)} human partners of release {releases}. Below each setting: the elbow's "
        "range and the strength that are left."
    )
    return save_figure(
        population_grid(pl.DataFrame(rows), caption=caption, width=width), path, bare=bare
    )


def _require(folder: Path, command: str, *names: str) -> None:
    """Raise a ValueError if a folder lacks the files of a command; say which command made it."""
    if not folder.is_dir():
        raise ValueError(f"{folder} is not a folder; run `assistax-zoo {command}` into it first")
    held = {tables.PAIRS_FILE: "a cross-play", tables.PROFILE_FILE: "an evaluation"}
    missing = [name for name in names if not (folder / name).is_file()]
    other = [what for name, what in held.items() if (folder / name).is_file()]
    if missing and other:
        raise ValueError(
            f"{folder} holds {other[0]}; this figure is of a folder that `assistax-zoo {command}` "
            "filled"
        )
    if missing:
        raise ValueError(
            f"{folder} lacks {', '.join(missing)}; run `assistax-zoo {command}` into it to its "
            "end; a stopped run continues"
        )
    check_whole(folder)
