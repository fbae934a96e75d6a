import itertools

import numpy as np
import polars as pl
import pytest
import scipy.stats

from evaluation.figures.metrics.curves import learning_curves


def metrics(seeds: int = 8) -> pl.DataFrame:
    """Updates of 100 steps; in every second one episodes end with 10 x update + seed."""
    rows = itertools.product(range(1, 41), ("d1", "d9"), range(seeds))
    values = [(100 * u, d, s, None if u % 2 else float(10 * u + s)) for u, d, s in rows]
    return pl.DataFrame(values, ["steps", "disability", "seed", "return"], orient="row")


def test_curve_point_is_iqm_of_bin_means():
    curves = learning_curves(metrics(), points=10)
    assert curves["disability"].unique().sort().to_list() == ["d1", "d9"]
    first = curves.filter(disability="d9").row(0, named=True)
    # Updates 2 and 4 end in the first 400 steps.
    expected = [np.mean([20 + s, 40 + s]) for s in range(8)]
    assert first["steps"] == 400.0
    assert first["iqm"] == pytest.approx(scipy.stats.trim_mean(expected, 0.25))
    assert first["low"] < first["iqm"] < first["high"]
    assert first["seeds"] == 8


def test_curve_omits_empty_bins():
    assert learning_curves(metrics(), points=1000).filter(disability="d1").height == 20


def test_a_single_seed_has_no_band():
    curves = learning_curves(metrics(seeds=1))
    assert curves["low"].null_count() == curves.height


def test_runs_without_episodes_are_refused():
    with pytest.raises(ValueError, match="no episode has ended in this run yet"):
        learning_curves(metrics().with_columns(pl.lit(None, pl.Float64).alias("return")))
    with pytest.raises(ValueError, match="the metrics lack seed, return"):
        learning_curves(metrics().drop("seed", "return"))
