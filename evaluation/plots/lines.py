"""Figures with lines and bands: performance profile, learning curves and speed."""

from collections.abc import Mapping

import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, StrMethodFormatter

from evaluation.plots import style

_WIDTH, _HEIGHT = 6.4, 4.2


def performance_profile(profiles: Mapping[str, pl.DataFrame], *, task: str, caption: str) -> Figure:
    """Draw the share of ego-partner pairs above each return, with 95% bands.

    Args:
        profiles: columns threshold, share, low and high, by the method's name.
        task: named in the title.
        caption: written below.
    """
    figure, axes = _canvas(f"Performance profile: {task}", caption)
    for i, (name, profile) in enumerate(profiles.items()):
        _line(
            axes,
            profile,
            "threshold",
            "share",
            style.OKABE_ITO[(i + 5) % len(style.OKABE_ITO)],
            name,
        )
    axes.set_xlabel("return", fontsize=9)
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
    figure, axes = _canvas(title, caption)
    for name, colour in style.disability_colours(curves["disability"]).items():
        _line(axes, curves.filter(disability=name), "steps", "iqm", colour, name)
    axes.set_xlabel("environment steps of one member", fontsize=9)
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
    figure, axes = _canvas("Open loop: environment steps per second", caption)
    groups = sorted(measured.select("task", "backend", "device").unique().rows())
    for i, (task, backend, device) in enumerate(groups):
        rows = measured.filter(task=task, backend=backend, device=device).sort("batch")
        colour = style.OKABE_ITO[i % len(style.OKABE_ITO)]
        label = f"{task}, {backend}, {device}"
        axes.plot(
            rows["batch"],
            rows["env_steps_per_second"],
            color=colour,
            marker="o",
            markersize=4,
            label=label,
        )
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_xlabel("simulations in the batch", fontsize=9)
    axes.set_ylabel("environment steps / s", fontsize=9)
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.yaxis.set_major_formatter(EngFormatter(sep=""))
    axes.legend(fontsize=7, frameon=False, loc="lower right")
    return figure


def _canvas(title: str, caption: str) -> tuple[Figure, Axes]:
    foot = 0.15 + style.caption_height(caption, _WIDTH)
    height = _HEIGHT + foot
    figure = style.new_figure(_WIDTH, height)
    axes = figure.add_axes(
        (0.75 / _WIDTH, (foot + 0.55) / height, 1 - 0.95 / _WIDTH, 3.1 / height), label="lines"
    )
    style.bare(axes, ("left", "bottom"))
    axes.tick_params(labelsize=8)
    axes.grid(color="#e5e5e5", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.text(
        0.2 / _WIDTH,
        1 - 0.14 / height,
        title,
        fontsize=12,
        weight="bold",
        va="top",
        color=style.INK,
    )
    style.write_caption(figure, caption)
    return figure, axes


def _line(axes: Axes, table: pl.DataFrame, x: str, y: str, colour: str, label: str) -> None:
    axes.plot(table[x], table[y], color=colour, linewidth=1.6, label=label)
    if not table["low"].null_count():
        axes.fill_between(
            table[x], table["low"], table["high"], color=colour, alpha=0.18, linewidth=0
        )
