"""Figures from saved tables: a plot evaluates nothing."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OrderName = Literal["shared", "separate"]


def crossplay(folder: Path, /, *, out: Path, order: OrderName | None = None) -> None:
    """Draw the clustered cross-play matrix that `crossplay` saved.

    Robots and humans are ordered by average linkage with optimal leaf order. With the same teams on
    both axes they share one order, and self-play is the diagonal.

    Args:
        folder: Folder that `assistax-zoo crossplay --out` filled.
        out: Figure to write, .png or .pdf.
        order: shared for one order of teams on both axes, or separate for one order each; default
            shared if possible.

    Example:
        assistax-zoo plot crossplay xp --out crossplay.pdf
    """
    from evaluation import tables
    from evaluation.plots.style import check_path

    check_path(out)
    _require(folder, tables.PAIRS_FILE, tables.ORDER_FILE, tables.SUMMARY_FILE, command="crossplay")
    from evaluation.plots.heatmap import crossplay_heatmap
    from evaluation.plots.matrix import arrange

    pairs = tables.read_parquet(folder / tables.PAIRS_FILE)
    matrix = arrange(pairs, tables.read_json(folder / tables.ORDER_FILE), order)
    _save(crossplay_heatmap(matrix, tables.read_json(folder / tables.SUMMARY_FILE)), out)


def zsc(folders: tuple[Path, ...], /, *, out: Path) -> None:
    """Draw the returns of methods with training and test partners, with 95% intervals.

    Args:
        folders: Folders that `assistax-zoo evaluate --split both --out` filled, one a method, named
            as in the figure.
        out: Figure to write, .png or .pdf.

    Example:
        assistax-zoo plot zsc results/ppo results/fcp --out zsc.pdf
    """
    from evaluation.plots.bars import zsc_bars

    _save(zsc_bars(_summaries(folders, out)), out)


def disability(folders: tuple[Path, ...], /, *, out: Path) -> None:
    """Draw the returns of methods with the partners of each disability setting, with 95% intervals.

    Args:
        folders: Folders that `assistax-zoo evaluate --out` filled, one a method, named as in the
            figure.
        out: Figure to write, .png or .pdf.

    Example:
        assistax-zoo plot disability results/ppo --out disability.png
    """
    from evaluation.plots.bars import disability_points

    _save(disability_points(_summaries(folders, out)), out)


def profile(folders: tuple[Path, ...], /, *, out: Path) -> None:
    """Draw performance profiles: the share of robot-partner pairs above each return.

    Args:
        folders: Folders that `assistax-zoo evaluate --out` filled, one a method, named as in the
            figure.
        out: Figure to write, .png or .pdf.

    Example:
        assistax-zoo plot profile results/ppo results/fcp --out profile.pdf
    """
    from evaluation import tables
    from evaluation.plots.bars import provenance
    from evaluation.plots.lines import performance_profile

    summaries = _summaries(folders, out, tables.PROFILE_FILE)
    profiles = {
        name: tables.read_parquet(folder / tables.PROFILE_FILE)
        for name, folder in zip(summaries, folders, strict=True)
    }
    task = " and ".join(sorted({summary["task"] for summary in summaries.values()}))
    caption = f"Bands: pointwise 95% bootstrap.\n{provenance(summaries)}"
    _save(performance_profile(profiles, task=task, caption=caption), out)


def curves(run: Path, /, *, out: Path) -> None:
    """Draw a training run's learning curves: IQM over seeds with 95% bands, one line a disability setting.

    Args:
        run: Folder that `assistax-zoo train --out` filled, or is filling.
        out: Figure to write, .png or .pdf.

    Example:
        assistax-zoo plot curves runs/scratch-ippo --out curves.pdf
    """
    from evaluation.curves import learning_curves
    from evaluation.plots import lines
    from evaluation.plots.style import check_path
    from evaluation.tables import read_json, read_parquet

    check_path(out)
    _require(run, "metrics.parquet", "config.json", command="train")
    table = learning_curves(read_parquet(run / "metrics.parquet"))
    config = read_json(run / "config.json")["config"]
    seeds = ", ".join(
        f"{name} {n}"
        for name, n in table.select("disability", "seeds").unique().sort("disability").rows()
    )
    caption = f"IQM of the return over seeds and its pointwise 95% bootstrap band. Seeds: {seeds}."
    title = f"Training: {config['task']}, {config.get('algorithm', 'ippo')}"
    _save(lines.learning_curves(table, title=title, caption=caption), out)


def speed(measured: tuple[Path, ...], /, *, out: Path) -> None:
    """Draw environment steps per second against the batch size.

    Args:
        measured: Files with what `python -m benchmarks env --json` printed.
        out: Figure to write, .png or .pdf.

    Example:
        assistax-zoo plot speed native.json warp.json --out speed.png
    """
    import polars as pl

    from evaluation.plots import lines
    from evaluation.plots.style import check_path

    check_path(out)
    if not measured:
        raise ValueError(
            "no file was given; give one or more that `python -m benchmarks env --json` printed"
        )
    names = ("task", "backend", "device", "batch", "env_steps_per_second")
    rows = [row for path in measured for row in json.loads(path.read_text(encoding="utf-8"))]
    if bad := [row for row in rows if not isinstance(row, dict) or set(names) - set(row)]:
        raise ValueError(
            f"{bad[0]!r} is not a row of `python -m benchmarks env --json`; it needs "
            f"{', '.join(names)}"
        )
    table = pl.DataFrame([{name: row[name] for name in names} for row in rows])
    _save(
        lines.speed(
            table, caption="Random actions; the median of three repeats, compilation not counted."
        ),
        out,
    )


def sweep(folder: Path, /, *, out: Path) -> None:
    """Draw a sweep: the final return over each hyperparameter, the best configuration marked.

    Args:
        folder: Folder that `assistax-zoo sweep --out` filled.
        out: Figure to write, .png or .pdf.

    Example:
        assistax-zoo plot sweep sweeps/ippo --out sweep.pdf
    """
    from evaluation.plots.style import check_path
    from evaluation.tables import read_json, read_parquet

    check_path(out)
    _require(folder, "sweep.parquet", "preset.json", command="sweep")
    from evaluation.plots.sweep import sweep_panels

    results = read_parquet(folder / "sweep.parquet")
    diverged = results.filter(results["diverged"]).height
    caption = (
        f"{results['configuration'].n_unique()} configurations x {results['seed'].n_unique()} "
        f"seeds, {diverged} runs diverged and are not drawn. Circles: the configuration with the "
        "best mean."
    )
    title = f"Sweep: {read_json(folder / 'preset.json')['algorithm']}"
    _save(sweep_panels(results, title=title, caption=caption), out)


def population(
    *, out: Path, task: str | None = None, release: str | None = None, registry: Path | None = None
) -> None:
    """Draw the published partners as a treemap by algorithm and disability setting.

    Args:
        out: Figure to write, .png or .pdf.
        task: Only this task.
        release: Only this release, such as v0.
        registry: Registry to read instead of the installed one.

    Example:
        assistax-zoo plot population --out population.png
    """
    from evaluation.plots.style import check_path
    from zoo.registry import load_registry

    check_path(out)
    entries = load_registry(registry).select(task=task, role="human", release=release)
    import polars as pl

    from evaluation.plots.treemap import population_treemap

    rows = [{"task": e.task, "algorithm": e.algorithm, "disability": e.disability} for e in entries]
    releases = ", ".join(sorted({entry.release for entry in entries}))
    caption = (
        f"n = {len(entries)} human partners of release {releases}. Areas are numbers of partners."
    )
    _save(population_treemap(pl.DataFrame(rows), caption=caption), out)


def _summaries(folders: Sequence[Path], out: Path, *others: str) -> dict[str, dict[str, Any]]:
    from evaluation import tables
    from evaluation.plots.style import check_path

    check_path(out)
    if not folders:
        raise ValueError(
            "no folder given; name at least one that `assistax-zoo evaluate --out` filled"
        )
    summaries: dict[str, dict[str, Any]] = {}
    for folder in folders:
        _require(folder, tables.SUMMARY_FILE, *others, command="evaluate")
        summary = tables.read_json(folder / tables.SUMMARY_FILE)
        if "m_test" not in summary:
            raise ValueError(
                f"{folder} holds no evaluation; give a folder that `assistax-zoo evaluate --out` "
                "filled"
            )
        name = folder.resolve().name
        if name in summaries:
            raise ValueError(
                f"two folders are named {name}; rename one, because the figure tells methods by it"
            )
        summaries[name] = summary
    return summaries


def _require(folder: Path, *names: str, command: str) -> None:
    if not folder.is_dir():
        raise ValueError(
            f"{folder} is not a folder; run `assistax-zoo {command} --out {folder}` first"
        )
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise ValueError(
            f"{folder} lacks {', '.join(missing)}; run `assistax-zoo {command} --out {folder}` to "
            "its end, a run that was stopped goes on"
        )


def _save(figure: "Figure", out: Path) -> None:
    from evaluation.plots.style import save_figure

    save_figure(figure, out)
    print(out)
