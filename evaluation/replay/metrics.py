"""Metrics of packages in a received folder: those installed here are computed again, no others.

A folder names a metric, its package and version. A name installs nothing, and only an installed
package of the same version can say again what its metric is.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import polars as pl

from assistax_base.errors import shorten
from assistax_base.extensions import METRICS, extensions
from evaluation.figures.metrics.installed import InstalledMetric, find_metrics
from evaluation.figures.summary import CrossPlaySummary, EvaluationSummary
from evaluation.record.alike import COLUMNS
from evaluation.record.columns import METRIC_PREFIX, metric_columns


@dataclasses.dataclass(frozen=True)
class ReceivedMetrics:
    """Metrics that a folder names."""

    installed: Mapping[str, InstalledMetric]  # here, in the same version
    absent: Mapping[str, str]  # the others: package and version by name

    @property
    def notes(self) -> list[str]:
        """A sentence on each metric that cannot be computed again."""
        return [
            f"metric {shorten(name)} of {shorten(source)}, which is not installed: cannot be told"
            for name, source in self.absent.items()
        ]

    def noise_notes(self, table: pl.DataFrame) -> list[str]:
        """Return a sentence on a table's columns of packages, whose noise was never measured."""
        names = ", ".join(metric_columns(self.without_absent(table)))
        return [f"{names} on another processor: cannot be told"] if names else []

    def without_absent(self, table: pl.DataFrame) -> pl.DataFrame:
        """Return a table without the columns that cannot be computed again."""
        return table.drop([METRIC_PREFIX + name for name in self.absent], strict=False)

    def without_figures(self, summary: Mapping[str, Any]) -> dict[str, Any]:
        """Return a summary, as JSON, without the figures that cannot be computed again."""
        rest = {name: value for name, value in summary.items() if name != "more"}
        more = {n: value for n, value in summary.get("more", {}).items() if n not in self.absent}
        return {**rest, "more": more} if more else rest


def received_metrics(
    identity: Mapping[str, Any], summary: EvaluationSummary | CrossPlaySummary
) -> ReceivedMetrics:
    """Return the metrics that a folder's job and summary name.

    Raises:
        ValueError: Job and summary name different packages.
    """
    columns = {n: (of["package"], of["version"]) for n, of in identity.get(COLUMNS, {}).items()}
    figures = {name: (figure.package, figure.version) for name, figure in summary.more.items()}
    for name in columns.keys() & figures.keys():
        if columns[name] != figures[name]:
            raise ValueError(
                f"metric {shorten(name)} is of another package in the manifest than in the "
                "summary; take the folder from where it was made"
            )
    known = {name: (e.package, e.version) for name, e in extensions(METRICS).items()}
    named = columns | figures
    here = [name for name, source in named.items() if known.get(name) == source]
    absent = {name: " ".join(source) for name, source in named.items() if name not in here}
    return ReceivedMetrics(find_metrics(here), absent)
