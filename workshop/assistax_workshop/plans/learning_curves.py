"""Learning curves in small files.

They are a run's metrics at a hundred points, one file for each group of a plan.
"""

from collections.abc import Sequence
from pathlib import Path

import polars as pl

from assistax_base.parquet import read_parquet, write_parquet
from population.config import TrainConfig

POINTS = 100
_MEMBER = ["task", "algorithm", "disability", "seed"]
_SCHEMA = {
    "task": pl.String,
    "algorithm": pl.String,
    "disability": pl.String,
    "seed": pl.Int64,
    "steps": pl.Int64,
}
# Metrics of episodes, written if a run has them: a figure of a gentle task needs all.
_MEASURES = ("return", "success", "violated", "term_force", "term_violation")


def thin(metrics: pl.DataFrame, config: TrainConfig, points: int = POINTS) -> pl.DataFrame:
    """Return each member's means over `points` stretches of equal length.

    Args:
        metrics: Metrics of a run: steps, disability, seed, episodes, and return, null if no
            episode ended. Some also have success, violated and the terms of forces.
        config: The run.
        points: Stretches; fewer if the run has fewer updates.

    Returns:
        Columns task, algorithm, disability, seed, steps (the end of the stretch), return and other
        measures that the metrics have: means over the stretch's episodes, null if it has none.
    """
    points = min(points, config.updates)
    stretch = (pl.col("update") * points / config.updates).ceil().cast(pl.Int64)
    ended = pl.col("return").is_not_null()
    weight = pl.col("episodes").filter(ended)
    present = [name for name in _MEASURES if name in metrics.columns]
    means = [
        ((pl.col(name).filter(ended) * weight).sum() / weight.sum()).fill_nan(None).alias(name)
        for name in present
    ]
    table = metrics.group_by("disability", "seed", stretch.alias("stretch")).agg(
        pl.col("steps").max(), *means
    )
    named = table.with_columns(
        pl.lit(config.task).alias("task"), pl.lit(config.algorithm).alias("algorithm")
    )
    schema = _SCHEMA | dict.fromkeys(present, pl.Float32)
    return named.select(pl.col(name).cast(dtype) for name, dtype in schema.items()).sort(
        *_MEMBER, "steps"
    )


def write_curves(path: Path, runs: Sequence[tuple[pl.DataFrame, TrainConfig]]) -> pl.DataFrame:
    """Write the curves of runs to one file, and return its table.

    Curves that the file holds of other members stay.

    Args:
        path: A Parquet file; its folder is created.
        runs: Metrics and configuration of each run.
    """
    new = pl.concat([thin(metrics, config) for metrics, config in runs], how="diagonal")
    old = read_parquet(path) if path.is_file() else new.clear()
    table = pl.concat([old.join(new, on=_MEMBER, how="anti"), new], how="diagonal").sort(
        *_MEMBER, "steps"
    )
    if not path.is_file() or not table.equals(old):
        write_parquet(table, path, compression="zstd", statistics=False)
    return table
