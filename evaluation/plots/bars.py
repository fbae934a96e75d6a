"""Figures of evaluations: returns with training and test partners, and with each setting."""

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evaluation.plots import style

_TRAIN, _TEST = "#9ecae1", "#08519c"


def zsc_bars(summaries: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw M_train beside M_test of each method, IQM with its 95% interval (paper, Figures 6, 14).

    Args:
        summaries: what `evaluate` saved, by the method's name.
    """
    figure, axes = _canvas(summaries, "Zero-shot coordination", 1.8 + 1.1 * len(summaries))
    sides = [
        ("training partners", "m_train", _TRAIN, -0.19),
        ("test partners", "m_test", _TEST, 0.19),
    ]
    for label, key, colour, shift in sides:
        found = [
            (i + shift, summary[key])
            for i, summary in enumerate(summaries.values())
            if summary[key]
        ]
        if not found:
            continue
        places, figures = zip(*found, strict=True)
        axes.bar(places, [value["iqm"] for value in figures], 0.36, color=colour, label=label)
        for place, value in found:
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
    axes.set_xticks(range(len(summaries)), list(summaries), fontsize=8)
    axes.set_xlim(-0.6, len(summaries) - 0.4)
    axes.axhline(0, color=style.FAINT, linewidth=0.6)
    axes.margins(y=0.12)
    _legend(axes, 2)
    return figure


def disability_points(summaries: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw each method's return with the partners of each setting: IQM with its 95% interval."""
    settings = sorted({name for summary in summaries.values() for name in summary["by_disability"]})
    figure, axes = _canvas(
        summaries, "Return by the partner's disability setting", 2.4 + 0.55 * len(settings)
    )
    for i, (label, summary) in enumerate(summaries.items()):
        shift = (i - (len(summaries) - 1) / 2) * min(0.2, 0.7 / len(summaries))
        colour = style.OKABE_ITO[(i + 5) % len(style.OKABE_ITO)]
        found = [(x + shift, summary["by_disability"].get(name)) for x, name in enumerate(settings)]
        found = [(place, value) for place, value in found if value]
        axes.plot(
            [x for x, _ in found],
            [value["iqm"] for _, value in found],
            "o",
            color=colour,
            markersize=5,
            label=label,
        )
        for place, value in found:
            _whisker(axes, place, value, colour)
    axes.set_xticks(range(len(settings)), settings, fontsize=8)
    axes.set_xlim(-0.6, len(settings) - 0.4)
    axes.grid(axis="y", color="#e5e5e5", linewidth=0.6)
    axes.set_axisbelow(True)
    _legend(axes, 3)
    return figure


def provenance(summaries: Mapping[str, Mapping[str, Any]]) -> str:
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


def _canvas(
    summaries: Mapping[str, Mapping[str, Any]], title: str, width: float
) -> tuple[Figure, Axes]:
    if not summaries:
        raise ValueError("there is nothing to draw; give at least one folder that evaluate filled")
    tasks = {summary["task"] for summary in summaries.values()}
    if len(tasks) > 1:
        raise ValueError(
            f"the folders are of several tasks, {', '.join(sorted(tasks))}; draw one task at a time"
        )
    width, caption = max(width, 6.2), _caption(summaries)
    foot = 0.42 + style.caption_height(caption, width)
    height = 3.35 + foot
    figure = style.new_figure(width, height)
    axes = figure.add_axes(
        (0.75 / width, (foot + 0.15) / height, 1 - 0.95 / width, 2.5 / height), label="returns"
    )
    style.bare(axes, ("left", "bottom"))
    axes.set_ylabel("return of an episode", fontsize=9, color=style.INK)
    axes.tick_params(axis="y", labelsize=8)
    heading = f"{title}: {tasks.pop()}"
    figure.text(
        0.2 / width,
        1 - 0.14 / height,
        heading,
        fontsize=12,
        weight="bold",
        va="top",
        color=style.INK,
    )
    style.write_caption(figure, caption)
    return figure, axes


def _whisker(axes: Axes, place: float, value: Mapping[str, Any], colour: str) -> None:
    if value["iqm_ci"]:
        axes.plot(
            [place, place], value["iqm_ci"], color=colour, linewidth=1.3, solid_capstyle="butt"
        )


def _legend(axes: Axes, columns: int) -> None:
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        ncols=columns,
        fontsize=8,
        frameon=False,
        borderaxespad=0.2,
    )


def _caption(summaries: Mapping[str, Mapping[str, Any]]) -> str:
    about = sorted(
        {
            to
            for summary in summaries.values()
            for to in _speaks_about([summary["m_test"], summary["m_train"]])
        }
    )
    first = f"IQM and 95% bootstrap interval, which generalises to new {'; new '.join(about)}."
    return f"{first}\n{provenance(summaries)}"


def _speaks_about(figures: Sequence[Mapping[str, Any] | None]) -> set[str]:
    return {value["generalises_to"] for value in figures if value}
