"""How people fared with a robot of a gentle task: figures of its episodes, and of several seeds."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import polars as pl

# Figures that pages show, and their names for readers.
CARE = {
    "caring_success": "caring success",
    "failed_persons": "persons failed",
    "discomfort": "discomfort",
    "violations": "violations",
    "with_people": "with people",  # caring success, of logs that the organiser accepted
}


def care_of(table: pl.DataFrame) -> dict[str, Any]:
    """Return shares by name, and the adaptation slope by wish, of one robot's episodes; JSON-ready.

    Those that the table does not measure are left out.
    """
    from evaluation.figures.metrics.adaptation import adaptation
    from evaluation.figures.metrics.caring import failed
    from evaluation.record.columns import VIOLATIONS, measures_care, wishes_of

    ordered = table.sort("partner", "episode")

    def values(name: str) -> np.ndarray:
        """Return a column [1, P, K]; NaN where it is empty."""
        numbers = ordered[name].cast(pl.Float64).to_numpy()
        return numbers.reshape(1, ordered["partner"].n_unique(), -1)

    found: dict[str, Any] = {"violations": float(values("violated").mean())}
    if not measures_care(table):
        return found
    kinds = {f"violations_{kind}": (table["violation"] == kind).mean() for kind in VIOLATIONS[1:]}
    slopes = {}
    for wish in wishes_of(table):
        one = adaptation(*(values(f"{what}_{wish}") for what in ("liked", "done", "within")))
        if one is not None:
            slope = {"slope": one.slope.value, "slope_ci": one.slope.value_ci, "within": one.within}
            slopes[wish] = slope
    return {
        **found,
        **kinds,
        "caring_success": float(values("success").mean()),
        "failed_persons": float(failed(values("success")).mean()),
        "discomfort": float(values("discomfort_share").mean()),
        "slopes": slopes,
    }


def mean_care(seeds: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Return the means of several seeds' figures, with `slope_WISH` of each wish."""
    flat: dict[str, list[float]] = {}
    for seed in seeds:
        slopes = {f"slope_{wish}": one["slope"] for wish, one in seed.get("slopes", {}).items()}
        shares = {name: seed[name] for name in CARE if name in seed}
        for name, value in (shares | slopes).items():
            flat.setdefault(name, []).append(value)
    return {name: float(np.mean(values)) for name, values in flat.items()}
