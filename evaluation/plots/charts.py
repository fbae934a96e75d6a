"""Figures with one pair of axes: returns as dots, profiles, learning curves, speed."""

import math
import types
from collections.abc import Mapping
from typing import Any

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, StrMethodFormatter

from assistax_base.errors import counted
from evaluation.cast.met_partners import UNKNOWN
from evaluation.figures.bootstrap import scope
from evaluation.plots import style

_DASHES = ("--", ":", "-.", (0, (5, 1)), (0, (1, 3)), (0, (3, 1, 1, 1)), (0, (8, 3)), (0, (2, 2)))

Summaries = Mapping[str, Mapping[str, Any]]  # what `evaluate` saved, by the method's name


def zsc_dots(
    summaries: Summaries, lines: Mapping[str, float] = types.MappingProxyType({})
) -> Figure:
    """Draw M_train beside M_test of each method, mean and 95% interval (paper, Figures 6, 14).

    The axis holds the dots and what they are compared with; it need not begin at zero.

    Args:
        summaries: of `evaluate`.
        lines: other returns to draw as lines, by name, beside those of the reference egos.
    """
    references = _references(summaries, lines)
    width, head = 2.6 + 0.9 * len(summaries), 0.2 * ((len(references) + 1) // 3)
    figure, axes = _returns(summaries, "Zero-shot coordination", width, head)
    colours = style.algorithm_colours(summaries)
    for i, (name, summary) in enumerate(summaries.items()):
        colour = colours[name]
        for key, shift, fill in (*_SIDES, ("m_test", 0.13, colour)):
            if value := summary.get(key):
                _whisker(axes, i + shift, value, colours[name])
                axes.plot(
                    [i + shift], [value["mean"]], "o", color=colours[name], markerfacecolor=fill
                )
                axes.annotate(
                    f"{value['mean']:.0f}",
                    (i + shift, value["mean"]),
                    (7, 0),
                    textcoords="offset points",
                    va="center",
                    fontsize=7,
                )
    labels = [("training partners", "white"), ("test partners", style.FAINT)]
    if any(summary.get("m_validation") for summary in summaries.values()):
        labels.insert(1, ("validation partners", style.GRID))
    for label, fill in labels:
        axes.plot([], [], "o", color=style.FAINT, markerfacecolor=fill, label=label)
    for (name, value), dashes in zip(references.items(), _DASHES, strict=False):
        axes.axhline(
            value,
            color=style.MUTED,
            linewidth=0.9,
            linestyle=dashes,
            label=f"{name} {value:.0f}",
            zorder=1.5,  # below the dots
        )
    axes.set_ylim(*_limits(summaries, references))
    axes.grid(axis="y", color=style.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    _name_places(axes, list(summaries))
    return figure


_SIDES = (("m_train", -0.13, "white"), ("m_validation", 0.0, style.GRID))  # beside the test's


def _limits(summaries: Summaries, references: Mapping[str, float]) -> tuple[float, float]:
    """Return limits that hold the dots with their intervals, and the references."""
    sides = ("m_train", "m_validation", "m_test")
    values = [s[key] for s in summaries.values() for key in sides if s.get(key)]
    ends = [end for value in values for end in (value["mean_ci"] or [value["mean"]])]
    low, high = min([*ends, *references.values()]), max([*ends, *references.values()])
    room = 0.15 * max(high - low, 0.02 * max(abs(low), abs(high)), 1e-6)
    return low - room, high + room


def _references(summaries: Summaries, lines: Mapping[str, float]) -> dict[str, float]:
    """Return what to compare with: references' means, of several methods their mean."""
    means: dict[str, list[float]] = {name: [value] for name, value in lines.items()}
    for summary in summaries.values():
        for name, value in (summary.get("references") or {}).items():
            if value is not None:
                means.setdefault(name.replace("_", " "), []).append(value["mean"])
    return {name: sum(values) / len(values) for name, values in means.items()}


def trait_points(summaries: Summaries, trait: str = "disability") -> Figure:
    """Draw each method's return by a trait of the partners: mean with its 95% interval.

    The trait is their "disability" setting or, of a gentle task, their "preference".
    """
    settings = sorted({n for summary in summaries.values() for n in summary.get(f"by_{trait}", ())})
    if summaries and not settings:
        raise ValueError(f"no partner of these folders has a {trait}; leave that figure out")
    what = {"disability": "disability setting", "preference": "preference"}[trait]
    title = f"Return by the partner's {what}"
    figure, axes = _returns(summaries, title, 2.4 + 0.55 * len(settings))
    colours = style.algorithm_colours(summaries)
    for i, (label, summary) in enumerate(summaries.items()):
        shift = (i - (len(summaries) - 1) / 2) * min(0.2, 0.7 / len(summaries))
        groups = summary.get(f"by_{trait}", {})
        places = {x + shift: groups[name] for x, name in enumerate(settings) if groups.get(name)}
        heights, colour = [value["mean"] for value in places.values()], colours[label]
        mark = style.MARKERS[i % len(style.MARKERS)]
        axes.plot(list(places), heights, mark, color=colour, markersize=5, label=label)
        for place, value in places.items():
            _whisker(axes, place, value, colour)
    _name_places(axes, settings)
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
    for name, colour in style.algorithm_colours(profiles).items():
        style.band(axes, profiles[name], "threshold", "share", colour, name)
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
    groups = sorted(measured.select("task", "backend", "device").unique().rows())
    tasks = sorted({task for task, _, _ in groups})
    kinds = sorted({(backend, device) for _, backend, device in groups})
    palette = (*dict.fromkeys(style.ALGORITHMS.values()), *style.OTHERS)
    columns = 2
    head = 0.2 * -(-len(groups) // columns)
    figure, axes = _lines(title, caption, "simulations in the batch", head)
    for task, backend, device in groups:
        rows = measured.filter(task=task, backend=backend, device=device).sort("batch")
        axes.plot(
            rows["batch"],
            rows["env_steps_per_second"],
            color=palette[kinds.index((backend, device)) % len(palette)],
            marker=style.MARKERS[tasks.index(task) % len(style.MARKERS)],
            markersize=5,
            markerfacecolor="none",
            label=f"{task}, {backend}, {device}",
            clip_on=False,
        )
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_ylabel("environment steps / s", fontsize=9)
    _whole_decades(axes, measured["env_steps_per_second"])
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.tick_params(axis="x", labelsize=7)
    axes.yaxis.set_major_formatter(EngFormatter(sep=""))
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns, fontsize=7, frameon=False)
    return figure


def _whole_decades(axes: Axes, values: pl.Series) -> None:
    """Let a logarithmic axis begin and end at a power of ten, so that nothing is cut."""
    known = [value for value in values.to_list() if value and value > 0]
    if known:
        low, high = math.floor(math.log10(min(known))), math.ceil(math.log10(max(known)))
        axes.set_ylim(10.0**low, 10.0 ** max(high, low + 1))


def provenance(summaries: Summaries) -> str:
    """Say how many robots, partners and episodes are behind a figure, of which release.

    Also where it is not known which partners the robots met in training.
    """
    lines = []
    for name, summary in summaries.items():
        partners = ", ".join(
            f"{count} {side}" for side, count in summary["partners"].items() if count
        )
        split = f", split {summary['split']['id']}" if summary["split"] else ""
        broken = f", {summary['nonfinite']} episodes non-finite" if summary["nonfinite"] else ""
        known = (summary.get("met") or {}).get("known")
        lines.append(
            f"{name}: {counted(len(summary['egos']), 'seed')} × {partners} partners × "
            f"{counted(summary['episodes_per_pair'], 'episode')}"
            f"{broken}; {summary['task']}, release {summary['release']}{split}, "
            f"{summary['backend']}{'' if known else f'; {UNKNOWN}'}"
        )
    return "\n".join(lines)


def _returns(
    summaries: Summaries, title: str, width: float, head: float = 0.0
) -> tuple[Figure, Axes]:
    """Return axes for the returns of evaluations, which are of one task.

    `head` inches more are kept above them for a legend.
    """
    if not summaries:
        raise ValueError("there is nothing to draw; give at least one folder that evaluate filled")
    tasks = {summary["task"] for summary in summaries.values()}
    if len(tasks) > 1:
        raise ValueError(
            f"the folders are of several tasks, {', '.join(sorted(tasks))}; draw one task at a time"
        )
    sides = ("m_test", "m_validation", "m_train")
    figures = [summary.get(key) for summary in summaries.values() for key in sides]
    scopes = sorted({scope(figure["generalises_to"]) for figure in figures if figure})
    caption = f"Mean; {'; '.join(scopes)} (bootstrap).\n{provenance(summaries)}"
    size = max(width, 6.2), 3.35 + head, 0.42
    figure, axes = _axes(f"{title}: {tasks.pop()}", caption, size, (0.15, 2.5), "returns")
    axes.set_ylabel("return of an episode", fontsize=9, color=style.INK)
    axes.tick_params(axis="y", labelsize=8)
    return figure, axes


def _lines(title: str, caption: str, x: str, head: float = 0.0) -> tuple[Figure, Axes]:
    """Return axes for lines; `head` inches above them are kept for a legend."""
    figure, axes = _axes(title, caption, (6.4, 4.2 + head, 0.15), (0.55, 3.1), "lines")
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
    if ends := value["mean_ci"]:
        axes.plot([place, place], ends, color=colour, linewidth=1.3, solid_capstyle="butt")


def _name_places(axes: Axes, names: list[str]) -> None:
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=3,
        fontsize=8,
        frameon=False,
        borderaxespad=0.2,
    )
