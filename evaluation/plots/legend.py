"""Texts around a cross-play heatmap: legend, headline and caption."""

import dataclasses
from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from assistax_base.errors import counted
from assistax_envs.disability import DISABILITY_SETTINGS
from evaluation.plots import style
from evaluation.plots.matrix import Matrix

LINE = 0.18  # inches


@dataclasses.dataclass(frozen=True)
class Line:
    """One line of a legend; without text it is a gap."""

    text: str = ""
    colour: str | None = None  # of the patch before the text
    heading: bool = False


def legend_lines(
    matrix: Matrix, algorithms: Mapping[str, str], disabilities: Mapping[str, str]
) -> list[Line]:
    """Return the legend's lines: algorithms and settings with colours, then clusters."""
    lines = [Line("algorithm", heading=True)]
    lines += [Line(style.spelled(name), colour) for name, colour in algorithms.items()]
    lines += [Line(), Line("disability", heading=True)]
    lines += [Line(f"{name}{_meaning(name)}", colour) for name, colour in disabilities.items()]
    if None in (*matrix.rows.algorithms, *matrix.columns.algorithms):
        lines += [Line("from outside the zoo", style.UNKNOWN)]
    sides = (
        [("teams", matrix.rows)]
        if matrix.shared
        else [("robots", matrix.rows), ("humans", matrix.columns)]
    )
    for what, side in sides:
        if side.silhouette is None:
            continue
        lines += [
            Line(),
            Line(f"clusters of {what} (silhouette {side.silhouette:.2f})", heading=True),
        ]
        if len(side.clusters) == 1:
            lines += [Line("none clear, all are one")]
            continue
        lines += [
            Line(f"{cluster.letter}  n = {cluster.stop - cluster.start}, medoid {cluster.medoid}")
            for cluster in side.clusters
        ]
    return lines


def in_columns(lines: list[Line], columns: int) -> list[list[Line]]:
    """Return the lines in columns; each block between gaps goes to the shortest column."""
    blocks: list[list[Line]] = [[]]
    for line in lines:
        blocks[-1].append(line)
        if line == Line():
            blocks.append([])
    dealt: list[list[Line]] = [[] for _ in range(columns)]
    for block in blocks:
        min(dealt, key=len).extend(block)
    return dealt


def draw_legend(axes: Axes, columns: list[list[Line]]) -> None:
    """Draw lines from the top of the axes, in columns of equal width."""
    axes.set_axis_off()
    box = axes.get_window_extent()
    height, width = (extent / axes.figure.dpi for extent in (box.height, box.width))
    axes.set(xlim=(0, width), ylim=(height, 0))  # both in inches
    for number, lines in enumerate(columns):
        for i, line in enumerate(lines):
            _draw_line(axes, line, number * width / len(columns), (i + 0.5) * LINE)


def _draw_line(axes: Axes, line: Line, x: float, y: float) -> None:
    if line.colour is not None:
        axes.add_patch(Rectangle((x, y - 0.055), 0.15, 0.11, facecolor=line.colour, linewidth=0))
        x += 0.21
    font = {"fontsize": 9, "weight": "bold"} if line.heading else {"fontsize": 8.5}
    axes.text(x, y, line.text, va="center", color=style.INK, fontdict=font)


def headline(summary: Mapping[str, Any]) -> str:
    """Return the text with self-play, cross-play and their gap, with intervals."""
    named = {
        "self-play": summary["self_play"],
        "cross-play": summary["cross_play"],
        "gap": summary["gap"],
    }
    return "mean and 95% interval: " + ",  ".join(
        f"{name} {_figure(value)}" for name, value in named.items() if value
    )


def caption(matrix: Matrix, summary: Mapping[str, Any], marked: str) -> str:
    """Return the caption with the task, numbers of policies and episodes, and the order."""
    rows, columns = matrix.values.shape
    split = f", split {summary['split']['id']}" if summary["split"] else ""
    order = (
        "one order of teams, self-play on the diagonal"
        if matrix.shared
        else "each axis in its own order, self-play"
    )
    order = order if marked or matrix.shared else "each axis in its own order"
    ending = "" if not marked else f" and marked {marked}" if matrix.shared else f" marked {marked}"
    return (
        f"n = {counted(rows, 'robot')} × {counted(columns, 'human')}, "
        f"{counted(summary['episodes_per_pair'], 'episode')} a pair "
        f"({summary['episodes']:,} episodes, {summary['nonfinite']} non-finite). Release "
        f"{summary['release']}{split}, environment version {summary['env_version']}, backend "
        f"{summary['backend']}. Average linkage, Euclidean distance, optimal leaf order; "
        f"{order}{ending}."
    )


def _figure(value: Mapping[str, Any]) -> str:
    interval = "" if value["mean_ci"] is None else " [{:z.0f}, {:z.0f}]".format(*value["mean_ci"])
    return f"{value['mean']:z.0f}{interval}"


def _meaning(name: str) -> str:
    setting = DISABILITY_SETTINGS.get(name)
    return f"  range {setting.elbow_range:g}, strength {setting.strength:g}" if setting else ""
