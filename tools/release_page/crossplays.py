"""Cross-plays of a release: a table with a row for each task, and the clustered matrices."""

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from evaluation.plots.crossplay.heatmap import crossplay_heatmap
from evaluation.plots.crossplay.matrix import arrange
from tools.release_page.data import CrossPlayed
from tools.release_page.markdown import MISSING, figure, spoken, table

_HEADINGS = (
    "task",
    "teams",
    "self-play IQM",
    "cross-play IQM",
    "lost with another's human, by means",
    "clusters",
    "silhouette",
)


def matrix_table(crossplays: Mapping[str, CrossPlayed], tasks: Sequence[str]) -> str:
    """Return a Markdown table of self-play and cross-play, a row for each task."""
    rows = [
        [
            spoken(task),
            *(_figures(crossplays[task]) if task in crossplays else [MISSING, *["–"] * 5]),
        ]
        for task in tasks
    ]
    return table(_HEADINGS, rows, range(1, len(_HEADINGS)))


def heatmap(played: CrossPlayed) -> Figure:
    """Return the figure of a cross-play's clustered matrix."""
    return crossplay_heatmap(arrange(played.pairs), played.summary)


def _figures(played: CrossPlayed) -> list[object]:
    """Return a task's cells, without the first."""
    summary, order = played.summary, played.order["teams"]
    gap = summary["relative_gap"]
    lost = "–" if gap is None else figure(gap, key="value", percent=True)
    fit = "–" if order["silhouette"] is None else f"{order['silhouette']:.2f}"
    return [
        summary["egos"],
        figure(summary["self_play"]),
        figure(summary["cross_play"]),
        lost,
        len(played.clusters),
        fit,
    ]
