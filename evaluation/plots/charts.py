"""Figures with one pair of axes: returns as bars and points, profiles, learning curves, speed."""

from collections.abc import Mapping
from typing import Any

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, StrMethodFormatter

from evaluation.plots import style

_TRAIN, _TEST = "#9ecae1", "#08519c"

Summaries = Mapping[str, Mapping[str, Any]]  # what `evaluate` saved, by the method's name


def zsc_bars(summaries: Summaries) -> Figure:
    """Draw M_train beside M_test of each method, IQM and 95% interval (paper, Figures 6, 14)."""
    figure, axes = _returns(summaries, "Zero-shot coordination", 1.8 + 1.1 * len(summaries))
    sides = [("training partners", "m_train", _TRAIN, -0.19)]
    sides += [("test partners", "m_test", _TEST, 0.19)]
    for label, key, colour, shift in sides:
        found = {i + shift: one[key] for i, one in enumerate(summaries.values()) if one[key]}
        if found:
            heights = [value["iqm"] for value in found.values()]
            axes.bar(list(found), heights, 0.36, color=colour, label=label)
        for place, value in found.items():
            _whisker(axes, place, value, style.INK)
            top = value["iqm_ci"][1] if value["iqm_ci"] else value["iqm"]
            axes.annotate(
                f"{value['iqm']:.0f}",
                (place, max(top, 0)),
                (0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=7,
            )
    _name_places(axes, list(summaries), 2)
    axes.axhline(0, color=style.FAINT, linewidth=0.6)
    axes.margins(y=0.12)
    return figure


def trait_points(summaries: Summaries, trait: str = "disability") -> Figure:
    """Draw each method's return by a trait of the partners: IQM with its 95% interval.

    The trait is their "disability" setting or, of a gentle task, their "preference".
    """
    settings = sorted({n for summary in summaries.values() for n in summary.get(f"by_{trait}", ())})
    if summaries and not settings:
        raise ValueError(f"no partner of these folders has a {trait}; leave that figure out")
    what = {"disability": "disability setting", "preference": "preference"}[trait]
    title = f"Return by the partner's {what}"
    figure, axes = _returns(summaries, title, 2.4 + 0.55 * len(settings))
    for i, (label, summary) in enumerate(summaries.items()):
        shift = (i - (len(summaries) - 1) / 2) * min(0.2, 0.7 / len(summaries))
        groups = summary.get(f"by_{trait}", {})
        found = {x + shift: groups[name] for x, name in enumerate(settings) if groups.get(name)}
        heights, colour = [value["iqm"] for value in found.values()], style.dark(i)
        axes.plot(list(found), heights, "o", color=colour, markersize=5, label=label)
        for place, value in found.items():
            _whisker(axes, place, value, colour)
    _name_places(axes, settings, 3)
    axes.grid(axis="y", color=style.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure


def performance_profile(profiles: Mapping[str, pl.DataFrame], *, task: str, caption: str) -> Figure:
    """Draw the share of ego-partner pairs above each return, with 95% bands.

    Args:
        profiles: columns threshold, share, low and high, by the method's name.
        task: named in the title.
        caption: written below.
    """
    figure, axes = _lines(f"Performance profile: {task}", caption, "return")
    for i, (name, profile) in enumerate(profiles.items()):
        style.band(axes, profile, "threshold", "share", style.dark(i), name)
    axes.set_ylabel("share of pairs above it", fontsize=9)
    axes.set_ylim(0, 1.02)
    axes.legend(fontsize=8, frameon=False, loc="lower left")
    return figure


def learning_curves(curves: pl.DataFrame, *, title: str, caption: str) -> Figure:
    """Draw the IQM over seeds with its 95% band, one line for each disability setting.

    Args:
        curves: columns disability, steps, iqm, low and high.
        title: written above.
        caption: written below.
    """
    figure, axes = _lines(title, caption, "environment steps of one member")
    for name, colour in style.disability_colours(curves["disability"]).items():
        style.band(axes, curves.filter(disability=name), "steps", "iqm", colour, name)
    axes.set_ylabel("return of an episode", fontsize=9)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    return figure


def speed(measured: pl.DataFrame, *, caption: str) -> Figure:
    """Draw environment steps per second against the batch size, both axes logarithmic.

    Args:
        measured: columns task, backend, device, batch and env_steps_per_second, as
            `python -m benchmarks env --json` prints them.
        caption: written below.
    """
    title = "Open loop: environment steps per second"
    figure, axes = _lines(title, caption, "simulations in the batch")
    groups = sorted(measured.select("task", "backend", "device").unique().rows())
    for i, (task, backend, device) in enumerate(groups):
        rows = measured.filter(task=task, backend=backend, device=device).sort("batch")
        axes.plot(
            rows["batch"],
            rows["env_steps_per_second"],
            color=style.OKABE_ITO[i % len(style.OKABE_ITO)],
            marker="o",
            markersize=4,
            label=f"{task}, {backend}, {device}",
        )
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_ylabel("environment steps / s", fontsize=9)
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.yaxis.set_major_formatter(EngFormatter(sep=""))
    axes.legend(fontsize=7, frameon=False, loc="lower right")
    return figure


def provenance(summaries: Summaries) -> str:
    """Say how many robots, partners and episodes are behind a figure, of which release."""
    lines = []
    for name, summary in summaries.items():
        partners = ", ".join(
            f"{count} {side}" for side, count in summary["partners"].items() if count
        )
        split = f", split {summary['split']['id']}" if summary["split"] else ""
        broken = f", {summary['nonfinite']} episodes non-finite" if summary["nonfinite"] else ""
        lines.append(
            f"{name}: {style.counted(len(summary['egos']), 'seed')} × {partners} partners × "
            f"{style.counted(summary['episodes_per_pair'], 'episode')}"
            f"{broken}; {summary['task']}, release {summary['release']}{split}, "
            f"{summary['backend']}"
        )
    return "\n".join(lines)


def _returns(summaries: Summaries, title: str, width: float) -> tuple[Figure, Axes]:
    """Return axes for the returns of evaluations, which are of one task."""
    if not summaries:
        raise ValueError("there is nothing to draw; give at least one folder that evaluate filled")
    tasks = {summary["task"] for summary in summaries.values()}
    if len(tasks) > 1:
        raise ValueError(
            f"the folders are of several tasks, {', '.join(sorted(tasks))}; draw one task at a time"
        )
    figures = [summary[key] for summary in summaries.values() for key in ("m_test", "m_train")]
    about = sorted({figure["generalises_to"] for figure in figures if figure})
    caption = (
        f"IQM and 95% bootstrap interval, which generalises to new {'; new '.join(about)}.\n"
        f"{provenance(summaries)}"
    )
    size = max(width, 6.2), 3.35, 0.42
    figure, axes = _axes(f"{title}: {tasks.pop()}", caption, size, (0.15, 2.5), "returns")
    axes.set_ylabel("return of an episode", fontsize=9, color=style.INK)
    axes.tick_params(axis="y", labelsize=8)
    return figure, axes


def _lines(title: str, caption: str, x: str) -> tuple[Figure, Axes]:
    figure, axes = _axes(title, caption, (6.4, 4.2, 0.15), (0.55, 3.1), "lines")
    axes.tick_params(labelsize=8)
    axes.grid(color=style.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel(x, fontsize=9)
    return figure, axes


def _axes(
    title: str,
    caption: str,
    size: tuple[float, float, float],
    span: tuple[float, float],
    label: str,
) -> tuple[Figure, Axes]:
    """Return a figure with axes.

    In inches its size and the room above the caption; the axes' bottom above that, and height.
    """
    width, foot = size[0], size[2] + style.caption_height(caption, size[0])
    height = size[1] + foot
    figure = style.titled_figure(title, caption, width, height)
    place = (0.75 / width, (foot + span[0]) / height, 1 - 0.95 / width, span[1] / height)
    axes = figure.add_axes(place, label=label)
    style.bare(axes, ("left", "bottom"))
    return figure, axes


def _whisker(axes: Axes, place: float, value: Mapping[str, Any], colour: str) -> None:
    if value["iqm_ci"]:
        axes.plot(
            [place, place], value["iqm_ci"], color=colour, linewidth=1.3, solid_capstyle="butt"
        )


def _name_places(axes: Axes, names: list[str], columns: int) -> None:
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=columns,
        fontsize=8,
        frameon=False,
        borderaxespad=0.2,
    )
