"""How people fared with the robots of a gentle task: figures that every page shows."""

import dataclasses
from typing import Any

import numpy as np
import polars as pl

from evaluation.figures.bootstrap import Estimate, Interval, estimate
from evaluation.figures.metrics.adaptation import Adaptation, adaptation
from evaluation.figures.metrics.comparison import Difference, paired_difference
from evaluation.figures.metrics.generalisation import estimate_of
from evaluation.record.columns import VIOLATIONS, measures_care, wishes_of
from evaluation.record.record import Returns

# The column of each share by which methods are compared.
SHARES = {
    "caring_success": "success",
    "discomfort": "discomfort_share",
    "violations": "violated",
}
FAILED = 0.5  # share of a person's episodes with caring success, below which it was failed


@dataclasses.dataclass(frozen=True, kw_only=True)
class CareFigures:
    """Figures of care; those that the task's version does not measure are None or empty."""

    violations: Estimate | None = None  # share of episodes
    violations_by_kind: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    # Share of episodes: the goal was reached as liked, without violation or much discomfort.
    caring_success: Estimate | None = None
    discomfort: Estimate | None = None  # share of felt steps, mean over episodes
    # Share of pairs of robot and person with caring success in less than half of the episodes,
    # without teams beside persons.
    failed_persons: Estimate | None = None
    adaptation: dict[str, Adaptation] = dataclasses.field(default_factory=dict)  # by wish


@dataclasses.dataclass(frozen=True, kw_only=True)
class CareComparison:
    """Care of method a and method b on the evaluated side; empty if it is not measured."""

    care: dict[str, Difference] = dataclasses.field(default_factory=dict)  # a - b, of `SHARES`
    # Adaptation slopes of a and b by wish; None where one is not defined.
    slopes: dict[str, tuple[Interval | None, Interval | None]] = dataclasses.field(
        default_factory=dict
    )


def care_figures(returns: Returns) -> CareFigures:
    """Return the figures of care of the robots and persons of some returns.

    Where teams play beside persons, shares of episodes are means of the groups' means, as M_test.
    """
    how: dict[str, Any] = {"groups": returns.groups, "common_starts": returns.common_starts}
    if returns.violated is None:
        return CareFigures()
    violations = estimate_of(returns.violated, **how)
    persons = returns.with_own_wishes.caring
    if returns.caring is None or persons is None:
        return CareFigures(violations=violations)
    kinds = returns.table["violation"].to_numpy()[returns.rows]
    return CareFigures(
        violations=violations,
        violations_by_kind={kind: estimate_of(kinds == kind, **how) for kind in VIOLATIONS[1:]},
        caring_success=estimate_of(returns.caring, **how),
        discomfort=estimate_of(returns.column("discomfort_share"), **how),
        failed_persons=estimate(failed(persons)),
        adaptation=adaptations(returns),
    )


def failed(caring: np.ndarray) -> np.ndarray:
    """Return whether robots failed persons [S, P], from caring success [S, P, K]."""
    return caring.mean(axis=2) < FAILED


def adaptations(returns: Returns) -> dict[str, Adaptation]:
    """Return the adaptation to each wish for which it is defined, by the wish's name.

    Where teams play beside persons it is that to the persons, whose wishes stay the same.
    """
    returns = returns.with_own_wishes
    found = {
        wish: adaptation(
            *(returns.column(f"{what}_{wish}") for what in ("liked", "done", "within"))
        )
        for wish in wishes_of(returns.table)
    }
    return {wish: one for wish, one in found.items() if one is not None}


def compare_care(a: Returns, b: Returns, *, seed: int = 0) -> CareComparison:
    """Return the comparison of two methods with the same persons and episodes."""
    if not (measures_care(a.table) and measures_care(b.table)):
        return CareComparison()
    care = {
        share: paired_difference(
            a.column(column), b.column(column), a.groups, common_starts=a.common_starts, seed=seed
        )
        for share, column in SHARES.items()
    }
    first, second = (
        {wish: found.slope for wish, found in adaptations(of).items()} for of in (a, b)
    )
    slopes = {wish: (first.get(wish), second.get(wish)) for wish in {**first, **second}}
    return CareComparison(care=care, slopes=slopes)


def persons_done(returns: Returns) -> pl.DataFrame:
    """Return what was done with each person, a row for each wish and person that was touched.

    Columns: `wish`, `partner`, `family`, `liked`, `done`, the geometric mean over robots and
    episodes, and `within`, the mean share of touch within a factor 1.5 of what is liked. Teams
    beside persons are left out.

    Raises:
        ValueError: Wishes are not measured, or no person was touched.
    """
    names = returns.with_own_wishes.partners["partner"].to_list()
    kept = returns.table.filter(pl.col("partner").is_in(names))
    tables = [
        kept.filter(pl.col(f"done_{wish}").is_not_null())
        .group_by("partner", pl.col("partner_algorithm").alias("family"))
        .agg(
            pl.col(f"liked_{wish}").cast(pl.Float64).log().mean().exp().alias("liked"),
            pl.col(f"done_{wish}").cast(pl.Float64).log().mean().exp().alias("done"),
            pl.col(f"within_{wish}").cast(pl.Float64).mean().alias("within"),
        )
        .select(pl.lit(wish).alias("wish"), pl.all())
        for wish in wishes_of(returns.table)
    ]
    if not tables:
        raise ValueError(
            "the episodes do not measure what was done of a wish; evaluate on a gentle task, in "
            "the version of today"
        )
    found = pl.concat(tables)
    if found.is_empty():
        raise ValueError("no person was touched late in an episode; evaluate a robot that helps")
    return found.sort("wish", "partner")
