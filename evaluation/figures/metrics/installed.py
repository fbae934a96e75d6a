"""Metrics that installed packages add, with the columns of the episode table that they need.

A package names each in an entry point of the group `assistax_zoo.metrics`. An evaluation or a
cross-play has the metrics that its user asks for by name, and no others: what is installed changes
no result.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from assistax_base.extensions import METRICS, Extension, extensions
from evaluation.figures.bootstrap import Estimate
from evaluation.figures.metrics.generalisation import estimate_of
from evaluation.record.record import Returns

if TYPE_CHECKING:
    from population.play.tally import Column


@dataclasses.dataclass(frozen=True)
class Metric:
    """A figure that a package adds.

    Args:
        title: Name and unit in tables for people, such as "change of the force, N/s".
        values: Function from the counted episodes to their values [E, P, K], or to scores [E, P] of
            pairs. `Returns.column` gives it any column of numbers in this form.
        column: Quantity that every episode then records, as the column `metric_NAME`.
    """

    title: str
    values: Callable[[Returns], Any]
    column: "Column | None" = None


@dataclasses.dataclass(frozen=True, eq=False)
class InstalledMetric:
    """A metric and its origin."""

    metric: Metric
    origin: Extension

    @property
    def source(self) -> dict[str, str]:
        """The package and its version."""
        return {"package": self.origin.package, "version": self.origin.version}


@dataclasses.dataclass(frozen=True, kw_only=True)
class MetricFigure(Estimate):
    """A package's metric: mean and IQM with intervals, and its origin."""

    title: str
    package: str
    version: str


def find_metrics(names: Sequence[str]) -> dict[str, InstalledMetric]:
    """Return metrics of installed packages by name, importing their modules.

    Args:
        names: Entry points of the group `assistax_zoo.metrics`.

    Raises:
        assistax_base.extensions.ExtensionError: A package's metric cannot be used.
    """
    known, found = extensions(METRICS), {}
    for name in names:
        metric = known[name].load()
        if not isinstance(metric, Metric):
            raise known[name].error(
                "a `Metric` of `evaluation.figures.metrics.installed`", repr(metric)
            )
        found[name] = InstalledMetric(metric, known[name])
    return found


def metric_figures(
    metrics: Mapping[str, InstalledMetric],
    returns: Returns,
    groups: Sequence[str] | None = None,
) -> dict[str, MetricFigure]:
    """Return the figures of metrics over all pairs of egos and partners.

    With the group of each partner, they are means of the groups' means.

    Raises:
        assistax_base.extensions.ExtensionError: A metric's values have another shape, or are not
            finite.
    """
    return {name: _figure(installed, returns, groups) for name, installed in metrics.items()}


def _figure(
    installed: InstalledMetric, returns: Returns, groups: Sequence[str] | None
) -> MetricFigure:
    shape = returns.values.shape
    values = np.asarray(installed.metric.values(returns), float)
    if values.shape not in (shape, shape[:2]) or not np.isfinite(values).all():
        expected = f"finite values of shape {shape} or {shape[:2]}"
        finite = "finite" if np.isfinite(values).all() else "not finite"
        raise installed.origin.error(expected, f"values of shape {values.shape}, {finite}")
    figure = estimate_of(values, groups, common_starts=returns.common_starts)
    return MetricFigure(**vars(figure), title=installed.metric.title, **installed.source)
