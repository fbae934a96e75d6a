"""Learning curves of the unimpaired setting, as in the paper's Figure 3."""

import polars as pl

from assistax_envs.versions import PAPER_TASKS
from evaluation.figures.metrics.curves import learning_curves
from tools.release_page.paper.data import Results

POINTS = 50  # half the stored points of a member, so that every bin has a point of each
RISING = 0.05  # a curve whose last fifth gains more than this share of the return is still rising


def training_curves(results: Results) -> pl.DataFrame:
    """Return columns task, algorithm, steps, iqm, low, high and seeds, for setting d1."""
    curves = []
    for task, algorithm in curve_kinds(results):
        assert results.curves is not None
        table = learning_curves(_of_kind(results.curves, task, algorithm), points=POINTS)
        last = _of_kind(results.curves, task, algorithm)["steps"].to_numpy().max()
        table = table.with_columns(
            pl.col("steps").clip(upper_bound=float(last))
        )  # the last bin may end beyond it
        curves.append(
            table.drop("disability").insert_column(0, pl.lit(algorithm).alias("algorithm"))
        )
        curves[-1].insert_column(0, pl.lit(task).alias("task"))
    return pl.concat(curves)


def curve_kinds(results: Results) -> list[tuple[str, str]]:
    """Return task and algorithm of the curves that there are of setting d1."""
    if results.curves is None:
        return []
    kinds = set(results.curves.filter(disability="d1").select("task", "algorithm").unique().rows())
    return sorted(kinds, key=lambda kind: (PAPER_TASKS.index(kind[0]), kind[1]))


def gained_last(curve: pl.DataFrame) -> float:
    """Return the share of the final IQM that a curve gained over its last fifth."""
    end = curve.row(-1, named=True)
    before = curve.filter(pl.col("steps") <= 0.8 * end["steps"])
    if before.is_empty() or end["iqm"] == 0:
        return 0.0
    return (end["iqm"] - before["iqm"][-1]) / abs(end["iqm"])


def _of_kind(curves: pl.DataFrame, task: str, algorithm: str) -> pl.DataFrame:
    return curves.filter(task=task, algorithm=algorithm, disability="d1")
