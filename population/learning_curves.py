"""Learning curves kept small.

A run's metrics at a hundred points, one file for each group of a plan.
"""

from collections.abc import Sequence
from pathlib import Path

import polars as pl

from population.config import TrainConfig
from population.files import atomic_path

POINTS = 100
_MEMBER = ["task", "algorithm", "disability", "seed"]
_SCHEMA = {
    "task": pl.String,
    "algorithm": pl.String,
    "disability": pl.String,
    "seed": pl.Int64,
    "steps": pl.Int64,
    "return": pl.Float32,
}


def thin(metrics: pl.DataFrame, config: TrainConfig, points: int = POINTS) -> pl.DataFrame:
    """Return each member's mean return over `points` stretches of equal length.

    Args:
        metrics: Metrics of a run: steps, disability, seed, episodes, and return, null where no
            episode ended.
        config: The run.
        points: Stretches; fewer if the run has fewer updates.

    Returns:
        Columns task, algorithm, disability, seed, steps (the end of the stretch) and return: the
        mean over its episodes, null where none ended.
    """
    points = min(points, config.updates)
    stretch = (pl.col("update") * points / config.updates).ceil().cast(pl.Int64)
    ended = pl.col("return").is_not_null()
    weight = pl.col("episodes").filter(ended)
    mean = (pl.col("return").filter(ended) * weight).sum() / weight.sum()
    table = metrics.group_by("disability", "seed", stretch.alias("stretch")).agg(
        pl.col("steps").max(), mean.fill_nan(None).alias("return")
    )
    named = table.with_columns(
        pl.lit(config.task).alias("task"), pl.lit(config.algorithm).alias("algorithm")
    )
    return named.select(pl.col(name).cast(dtype) for name, dtype in _SCHEMA.items()).sort(
        *_MEMBER, "steps"
    )


def write_curves(path: Path, runs: Sequence[tuple[pl.DataFrame, TrainConfig]]) -> pl.DataFrame:
    """Write the curves of runs to one file; members that it holds of other runs stay in it.

    Args:
        path: A Parquet file; its folder is created.
        runs: Metrics and configuration of each run.
    """
    new = pl.concat([thin(metrics, config) for metrics, config in runs])
    old = pl.read_parquet(path) if path.is_file() else new.clear()
    table = pl.concat([old.join(new, on=_MEMBER, how="anti"), new]).sort(*_MEMBER, "steps")
    if not path.is_file() or not table.equals(old):
        with atomic_path(path) as temporary:
            table.write_parquet(temporary, compression="zstd", statistics=False)
    return table
