"""Learning curves of a run's members: IQM over seeds with its band, for each disability setting."""

import numpy as np
import polars as pl

from assistax_base.statistics import iqm
from evaluation.figures.bootstrap import curve_band

COLUMNS = {
    "disability": pl.String,
    "steps": pl.Float64,
    "iqm": pl.Float64,
    "low": pl.Float64,
    "high": pl.Float64,
}


def learning_curves(metrics: pl.DataFrame, *, points: int = 100) -> pl.DataFrame:
    """Return curves with columns disability, steps, iqm, low, high and seeds.

    A single seed has no band.

    Args:
        metrics: A run's metrics: steps, disability, seed, and return, which is null if no episode
            ended.
        points: Number of bins of equal width over the steps. A bin is used if every seed has an
            episode in it.

    Raises:
        ValueError: A column is missing, or no episode has ended yet.
    """
    missing = [
        name for name in ("steps", "disability", "seed", "return") if name not in metrics.columns
    ]
    if missing:
        raise ValueError(
            f"the metrics lack {', '.join(missing)}; give the metrics of a training run"
        )
    ended = metrics.filter(pl.col("return").is_not_null())
    if ended.is_empty():
        raise ValueError("no episode has ended in this run yet; train on until one has")
    width = max(float(np.asarray(metrics["steps"].max())) / points, 1.0)
    binned = ended.with_columns((pl.col("steps") / width).ceil().alias("bin"))
    cells = binned.group_by("disability", "seed", "bin").agg(pl.col("return").mean())
    curves = [
        _curve(cells.filter(disability=name), name, width)
        for name in cells["disability"].unique().sort()
    ]
    return pl.concat(curves)


def _curve(cells: pl.DataFrame, name: str, width: float) -> pl.DataFrame:
    wide = cells.sort("bin", "seed").pivot("seed", index="bin", values="return").drop_nulls()
    values = wide.drop("bin").to_numpy().T  # [S, T]
    if wide.is_empty():
        raise ValueError(
            f"no episodes of all seeds of {name} ended together; take fewer points or train on"
        )
    band = curve_band(values)
    centre, low, high = band if band else ([iqm(column) for column in values.T], None, None)
    columns = {
        "disability": [name] * wide.height,
        "steps": wide["bin"] * width,
        "iqm": centre,
        "low": low,
        "high": high,
    }
    return pl.DataFrame(columns, schema=COLUMNS).with_columns(pl.lit(len(values)).alias("seeds"))
