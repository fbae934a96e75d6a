"""Figures with one pair of axes: returns as dots, profiles, learning curves, speed."""

import textwrap
import types
from collections.abc import Mapping
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, StrMethodFormatter

from evaluation.figures.bootstrap import scope
from evaluation.plots import style
from evaluation.plots.captions import Summaries, provenance

_DASHES = ("--", ":", "-.", (0, (5, 1)), (0, (1, 3)), (0, (3, 1, 1, 1)), (0, (8, 3)), (0, (2, 2)))

_LEFT, _NARROWEST = 0.75, 1.2  # inches: left of axes, and their least width

References = Mapping[str, Mapping[int, float]]  # name -> place of a method -> height of its line


@style.own_style()
def zsc_dots(
    summaries: Summaries,
    lines: Mapping[str, float] = types.MappingProxyType({}),
    *,
    width: float | None = None,
    note: str = "",
) -> Figure:
    """Draw M_train beside M_test of each method, mean and 95% interval (paper, Figures 6, 14).

    The axis includes the dots and, beside each, the references of its own folder, but not always 0.

    Args:
        summaries: Summaries of `evaluate`, by the method's name.
        lines: Other returns to draw as lines, by name, beside those of the reference egos.
        width: Width of the figure, in inches.
        note: The caption's end.

    Raises:
        ValueError: No folder has the mean of a side: groups of its test side did not play.
    """
    if summaries and not any(s.get(key) for s in summaries.values() for key in _MEANS):
        raise ValueError(
            "these folders have no M_test, since groups of their test sides did not play, and no "
            "M_train; evaluate with all groups"
        )
    references = _references(summaries, lines)
    room = style.room_for(references)
    size = width or max(2.6 + 0.9 * len(summaries), 6.2) + room - 0.15
    figure, axes = _returns(summaries, "Zero-shot coordination", size, note, room)
    colours = style.algorithm_colours(summaries)
    for i, (name, summary) in enumerate(summaries.items()):
        colour = colours[name]
        for key, shift, fill in (*_SIDES, ("m_test", 0.13, colour)):
            if value := summary.get(key):
                _whisker(axes, i + shift, value, colour)
                axes.plot([i + shift], [value["mean"]], "o", color=colour, markerfacecolor=fill)
                axes.annotate(
                    f"{value['mean']:z.0f}",
                    (i + shift, value["mean"]),
                    (-7 if shift < 0 else 7, 0),
                    textcoords="offset points",
                    ha="right" if shift < 0 else "left",
                    va="center",
                    fontsize=7,
                    bbox=style.BEHIND,
                )
    validated = any(summary.get("m_validation") for summary in summaries.values())
    between = [("validation partners", style.GRID)] * validated
    for label, fill in (("training partners", "white"), *between, ("test partners", style.FAINT)):
        axes.plot([], [], "o", color=style.FAINT, markerfacecolor=fill, label=label)
    for heights, dashes in zip(references.values(), _DASHES, strict=False):
        below: Any = {"color": style.MUTED, "linewidth": 0.9, "zorder": 1.5}  # the dots
        left, right = ([place + half for place in heights] for half in (-0.5, 0.5))
        axes.hlines([*heights.values()], left, right, linestyles=dashes, **below)
    axes.set_ylim(*_limits(summaries, references))
    _name_places(axes, [style.spelled(name) for name in summaries])
    ends = {name: (len(summaries) - 0.4, own[max(own)]) for name, own in references.items()}
    style.label_ends(axes, ends, dict.fromkeys(ends, style.MUTED))
    return figure


_MEANS = ("m_train", "m_validation", "m_test")
_SIDES = (("m_train", -0.13, "white"), ("m_validation", 0.0, style.GRID))  # beside the test's


def _limits(summaries: Summaries, references: References) -> tuple[float, float]:
    """Return axis limits that include the dots with their intervals, and the references."""
    values = [s[key] for s in summaries.values() for key in _MEANS if s.get(key)]
    ends = [end for value in values for end in (value["mean_ci"] or [value["mean"]])]
    ends += [height for heights in references.values() for height in heights.values()]
    low, high = min(ends), max(ends)
    room = 0.15 * max(high - low, 0.02 * max(abs(low), abs(high)), 1e-6)
    return low - room, high + room


def _references(summaries: Summaries, lines: Mapping[str, float]) -> References:
    """Return the means of each method's own references, and of `lines`, by name and method."""
    means = {name: dict.fromkeys(range(len(summaries)), value) for name, value in lines.items()}
    for place, summary in enumerate(summaries.values()):
        for name, value in (summary.get("references") or {}).items():
            if value is not None:
                means.setdefault(name.replace("_", " "), {})[place] = value["mean"]
    spans = {
        name: " to ".join(dict.fromkeys(f"{end(heights.values()):.0f}" for end in (min, max)))
        for name, heights in means.items()
    }
    return {textwrap.fill(f"{name} {spans[name]}", 16): means[name] for name in means}


@style.own_style()
def trait_points(
    summaries: Summaries, trait: str = "disability", *, width: float | None = None, note: str = ""
) -> Figure:
    """Draw each method's return by a trait of the partners: mean with its 95% interval.

    The trait is "disability", "group" of a test side or, for a gentle task, "preference". The
    width is in inches, and the note ends the caption.
    """
    settings = sorted({n for summary in summaries.values() for n in summary.get(f"by_{trait}", ())})
    if summaries and not settings:
        raise ValueError(f"no partner of these folders has a {trait}; leave that figure out")
    what = {"disability": "disability setting"}.get(trait, trait)
    title = f"Return by the partner's {what}"
    size = width or max(2.4 + 0.55 * len(settings), 6.2)
    figure, axes = _returns(summaries, title, size, note, marks=len(summaries))
    axes.set_xlabel(what, fontsize=9, color=style.INK)
    colours = style.algorithm_colours(summaries)
    for i, (label, summary) in enumerate(summaries.items()):
        shift = (i - (len(summaries) - 1) / 2) * min(0.2, 0.7 / len(summaries))
        groups = summary.get(f"by_{trait}", {})
        places = {x + shift: groups[name] for x, name in enumerate(settings) if groups.get(name)}
        heights, colour = [value["mean"] for value in places.values()], colours[label]
        mark = style.MARKERS[i % len(style.MARKERS)]
        axes.plot(
            list(places), heights, mark, color=colour, markersize=5, label=style.spelled(label)
        )
        for place, value in places.items():
            _whisker(axes, place, value, colour)
    _name_places(axes, settings)
    return figure


@style.own_style()
def performance_profile(
    profiles: Mapping[str, pl.DataFrame], *, task: str, caption: str, width: float | None = None
) -> Figure:
    """Draw the share of ego-partner pairs above each return, with 95% bands.

    Args:
        profiles: Tables with columns threshold, share, low and high, by the method's name.
        task: The task, for the title.
        caption: Text below the figure.
        width: Width of the figure, in inches.
    """
    figure, axes = _lines(f"Performance profile: {task}", caption, "return of an episode", width)
    colours = style.algorithm_colours(profiles)
    for name, colour in colours.items():
        style.band(axes, profiles[name], "threshold", "share", colour, name)
    axes.set_ylabel("share of pairs above it", fontsize=9)
    axes.set_ylim(0, 1.02)
    _label_falls(axes, profiles, colours)
    return figure


def _label_falls(
    axes: Axes, profiles: Mapping[str, pl.DataFrame], colours: Mapping[str, str]
) -> None:
    """Write each profile's name at a different share, because all profiles end at 0."""
    shares = np.linspace(0.85, 0.15, len(profiles)) if len(profiles) > 1 else [0.5]
    best_last = sorted(profiles, key=lambda name: -profiles[name]["share"].sum())
    for name, share in zip(best_last, shares, strict=True):
        table = profiles[name]
        place = float(table["threshold"][int((table["share"] >= share).sum()) - 1])
        font: Any = {"fontsize": style.END, "color": colours[name], "bbox": style.BEHIND}
        offset: Any = {"textcoords": "offset points", "va": "center"}
        axes.annotate(style.spelled(name), (place, share), (7.0, 0.0), **offset, **font)


@style.own_style()
def learning_curves(
    curves: pl.DataFrame, *, title: str, caption: str, width: float | None = None
) -> Figure:
    """Draw the IQM over seeds with its 95% band, one line for each disability setting.

    Args:
        curves: Table with columns disability, steps, iqm, low and high.
        title: Text above the figure.
        caption: Text below the figure.
        width: Width of the figure, in inches.
    """
    colours = style.disability_colours(curves["disability"])
    x = "environment steps of one member"
    figure, axes = _lines(title, caption, x, width, right=style.room_for(colours))
    ends = {}
    for name, colour in colours.items():
        curve = curves.filter(disability=name)
        style.band(axes, curve, "steps", "iqm", colour, name)
        ends[name] = curve["steps"][-1], curve["iqm"][-1]
    axes.set_ylabel("return of an episode", fontsize=9)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    style.label_ends(axes, ends, colours)
    return figure


@style.own_style()
def speed(measured: pl.DataFrame, *, caption: str, width: float | None = None) -> Figure:
    """Draw environment steps per second against the batch size, both axes logarithmic.

    Args:
        measured: Table with columns task, backend, device, batch and env_steps_per_second, as
            `python -m benchmarks env --json` prints them.
        caption: Text below the figure.
        width: Width of the figure, in inches.
    """
    title = "Open loop: environment steps per second"
    tasks = sorted(set(measured["task"]))
    kinds = sorted(set(measured.select("backend", "device").rows()))
    pale = style.ALGORITHMS["isac"]  # well seen in a strip, as a thin line it is not
    palette = [c for c in dict.fromkeys((*style.ALGORITHMS.values(), *style.OTHERS)) if c != pale]
    colours = {f"{b},\n{d}": palette[i % len(palette)] for i, (b, d) in enumerate(kinds)}
    room = style.room_for(colours)
    figure, axes = _lines(title, caption, "simulations in the batch", width, 0.25, room)
    ends: dict[str, tuple[float, float]] = {}
    for (task, backend, device), rows in sorted(measured.group_by("task", "backend", "device")):
        rows, name = rows.sort("batch"), f"{backend},\n{device}"
        marks: Any = {
            "marker": style.MARKERS[tasks.index(task) % len(style.MARKERS)],
            "markersize": 5,
        }
        x, y = rows["batch"], rows["env_steps_per_second"]
        axes.plot(x, y, color=colours[name], markerfacecolor="none", clip_on=False, **marks)
        ends[name] = max(ends.get(name, (0.0, 0.0)), (x[-1], y[-1]))
    for mark, task in zip(style.MARKERS, tasks, strict=False):
        axes.plot([], [], mark, color=style.MUTED, markerfacecolor="none", label=task)
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_ylabel("environment steps / s", fontsize=9)
    style.whole_decades(axes, measured["env_steps_per_second"])
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.tick_params(axis="x", labelsize=7)
    axes.yaxis.set_major_formatter(EngFormatter(sep=""))
    style.label_ends(axes, ends, colours)
    above = {"loc": "lower left", "bbox_to_anchor": (0, 1.0), "ncols": 3, "columnspacing": 1.0}
    axes.legend(fontsize=8, frameon=False, borderaxespad=0.2, handletextpad=0.2, **above)
    return figure


def _returns(
    summaries: Summaries, title: str, width: float, note: str, right: float = 0.2, marks: int = 2
) -> tuple[Figure, Axes]:
    """Return axes for the returns of evaluations of one task.

    There are `right` inches beside them for names of lines, and room above for a legend.
    """
    if not summaries:
        raise ValueError("there is nothing to draw; give at least one folder that evaluate filled")
    tasks = {summary["task"] for summary in summaries.values()}
    if len(tasks) > 1:
        raise ValueError(
            f"the folders are of several tasks, {', '.join(sorted(tasks))}; draw one task at a time"
        )
    figures = [summary.get(key) for summary in summaries.values() for key in _MEANS]
    scopes = sorted({scope(figure["generalises_to"]) for figure in figures if figure})
    caption = f"Mean; {'; '.join(scopes)} (bootstrap).\n{provenance(summaries)}{note}"
    rows = -(-marks // _columns(width - _LEFT - right))
    size, span = (width, 3.4 + 0.17 * rows, 0.42), (0.35, 2.5, right)
    figure, axes = _axes(f"{title}: {tasks.pop()}", caption, size, span, "returns")
    axes.set_ylabel("return of an episode", fontsize=9, color=style.INK)
    axes.tick_params(axis="y", labelsize=8)
    axes.grid(axis="y", color=style.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _lines(
    title: str, caption: str, x: str, width: float | None, head: float = 0.0, right: float = 0.2
) -> tuple[Figure, Axes]:
    """Return axes for lines, with `head` inches above and `right` inches beside them."""
    size = width or 6.2 + right, 4.2 + head, 0.15
    figure, axes = _axes(title, caption, size, (0.55, 3.1, right), "lines")
    axes.tick_params(labelsize=8)
    axes.grid(color=style.GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel(x, fontsize=9)
    return figure, axes


def _axes(
    title: str,
    caption: str,
    size: tuple[float, float, float],
    span: tuple[float, float, float],
    label: str,
) -> tuple[Figure, Axes]:
    """Return axes in a new figure.

    All sizes are in inches: the figure's, the room above the caption, the axes' bottom above that
    room, their height, and the room beside them.
    """
    style.check_width(size[0], _LEFT + _NARROWEST + span[2])
    width, foot = size[0], size[2] + style.caption_height(caption, size[0])
    height = size[1] + foot
    figure = style.titled_figure(title, caption, width, height)
    across = 1 - (_LEFT + span[2]) / width
    place = (_LEFT / width, (foot + span[0]) / height, across, span[1] / height)
    axes = figure.add_axes(place, label=label)
    style.bare(axes, ("left", "bottom"))
    return figure, axes


def _whisker(axes: Axes, place: float, value: Mapping[str, Any], colour: str) -> None:
    if ends := value["mean_ci"]:
        axes.plot([place, place], ends, color=colour, linewidth=1.3, solid_capstyle="butt")


def _name_places(axes: Axes, names: list[str]) -> None:
    inches = axes.get_window_extent().width / axes.figure.dpi
    tight = max(map(len, names)) * 0.065 > inches / (len(names) + 0.2)
    turned: dict[str, Any] = {"rotation": 25, "ha": "right", "rotation_mode": "anchor"}
    axes.set_xticks(range(len(names)), names, fontsize=8, **(turned if tight else {}))
    axes.set_xlim(-0.6, len(names) - 0.4)
    above = {"loc": "lower left", "bbox_to_anchor": (0, 1.0), "ncols": _columns(inches)}
    axes.legend(fontsize=8, frameon=False, borderaxespad=0.2, **above)


def _columns(inches: float) -> int:
    """Return the number of columns of a legend above axes of a width in inches."""
    return max(1, min(3, int(inches // 1.3)))
