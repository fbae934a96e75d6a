"""The interval that a plan promises is the one that the bootstrap gives."""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from evaluation.figures.bootstrap import estimate
from evaluation.figures.metrics.inference import mean_test
from evaluation.figures.metrics.variance import Spread, measure_spread, spread_of
from evaluation.figures.planning import (
    MEASURED,
    ContrastSpread,
    measure_contrast,
    plan_contrast,
    plan_evaluation,
)
from tests.evaluation.test_variance import drawn

EGOS = Path(__file__).parents[2] / "docs" / "data" / "paper" / "egos"
TRUE = Spread(seeds=30.0, partners=50.0, pairs=40.0, episodes=80.0, starts=90.0)


def published(task: str, method: str) -> tuple[np.ndarray, np.ndarray, int]:
    """Return means and deviations [S, P] of a published table with test partners."""
    table = pl.read_parquet(EGOS / f"{task}-{method}" / "pairs.parquet")
    table = table.filter(pl.col("side") == "test").sort("ego", "partner")
    shape = table["ego"].n_unique(), table["partner"].n_unique()
    scores, deviations = (table[name].to_numpy().reshape(shape) for name in ("return", "return_sd"))
    return scores, deviations, int(table["episodes"][0])


def as_table(returns: np.ndarray) -> pl.DataFrame:
    ego, partner, episode = (axis.ravel().astype(str) for axis in np.indices(returns.shape))
    columns = {"ego": ego, "partner": partner, "episode": episode, "return": returns.ravel()}
    return pl.DataFrame(columns)


def found(scores: np.ndarray, resamples: int = 1000) -> float:
    """Return the bootstrap's half-width, of a mean."""
    interval = estimate(scores, resamples=resamples).mean_ci
    assert interval is not None
    return (interval[1] - interval[0]) / 2


@functools.cache
def typical_width(shape: tuple[int, int]) -> float:
    """Return the root mean square of half-widths: the formula is of an expected variance."""
    rng = np.random.default_rng(3)
    squares = [found(drawn(rng, TRUE, (*shape, 4)), 400) ** 2 for _ in range(80)]
    return float(np.sqrt(np.mean(squares)))


@pytest.mark.parametrize("shape", [(1, 40), (2, 40), (5, 20), (16, 60), (30, 8)])
def test_the_bootstrap_gives_the_promised_width(shape: tuple[int, int]) -> None:
    assert typical_width(shape) == pytest.approx(TRUE.half_width(*shape, 4), rel=0.1)


@pytest.mark.parametrize("missing", ["seeds", "partners", "pairs", "episodes", "starts"])
def test_planted_defect_missing_variance_term_is_caught(missing: str) -> None:
    without = dataclasses.replace(TRUE, **{missing: 0.0})
    shapes = {"seeds": (16, 60), "pairs": (1, 40), "episodes": (1, 40)}
    shape = shapes.get(missing, (30, 8))
    assert typical_width(shape) > 1.1 * without.half_width(*shape, 4)


@pytest.mark.parametrize("task", MEASURED)
@pytest.mark.parametrize("method", ["ppo", "sac"])
def test_published_tables(task: str, method: str) -> None:
    scores, deviations, episodes = published(task, method)
    kept = MEASURED[task][method]
    noise = float((deviations.astype(float) ** 2).mean()) - kept.starts**2
    spread = spread_of(scores, episodes, noise, starts=0.0)  # the tables' starts are common
    without = dataclasses.asdict(dataclasses.replace(kept, starts=0.0))
    assert without == pytest.approx(dataclasses.asdict(spread), abs=0.05)
    assert found(scores) == pytest.approx(spread.half_width(*scores.shape, episodes), rel=0.06)


def test_a_spread_is_measured_from_episodes() -> None:
    table = as_table(drawn(np.random.default_rng(5), TRUE, (40, 50, 6)))
    shuffled = table.sample(fraction=1.0, shuffle=True, seed=1)
    measured = dataclasses.asdict(measure_spread(shuffled))
    assert measured == pytest.approx(dataclasses.asdict(TRUE), rel=0.25)
    with pytest.raises(ValueError, match="every ego with every partner"):
        measure_spread(table.filter((pl.col("ego") != "1") | (pl.col("partner") != "2")))
    with pytest.raises(ValueError, match="two of each"):
        measure_spread(table.filter(pl.col("ego") == "1"))


def test_plan_minimises_seeds_then_episodes() -> None:
    plan = plan_evaluation(15.0, spread=TRUE, partners=100)
    assert plan.half_width <= 15.0
    assert TRUE.half_width(plan.seeds - 1, 100, 32) > 15.0
    assert TRUE.half_width(plan.seeds, 100, plan.episodes - 1) > 15.0


def test_unreachable_width_is_refused() -> None:
    with pytest.raises(ValueError, match=r"64 seeds with 59 partners reach \d+\.\d"):
        plan_evaluation(1.0, task="arm_assist")


CONTRAST = ContrastSpread(seeds=30.0, partners=50.0, pairs=40.0, episodes=80.0)


def two_pilots(rng: np.random.Generator, shape: tuple[int, int, int], effect: float = 0.0):
    """Return the returns of two methods that share partners' effects and starts."""
    s, p, k = shape
    shared = rng.normal(0.0, 70.0, (1, p, 1)) + rng.normal(0.0, 60.0, (1, p, k))
    apart = rng.normal(effect, CONTRAST.partners, (1, p, 1))

    def method(bias: np.ndarray) -> np.ndarray:
        return (
            rng.normal(0.0, CONTRAST.seeds, (s, 1, 1))
            + rng.normal(0.0, CONTRAST.pairs, (s, p, 1))
            + rng.normal(0.0, CONTRAST.episodes, (s, p, k))
            + shared
            + bias
        )

    return method(apart), method(np.zeros((1, p, 1)))


def test_contrast_spread_omits_partner_effects() -> None:
    rng = np.random.default_rng(8)
    found = [
        dataclasses.astuple(measure_contrast(*map(as_table, two_pilots(rng, (12, 40, 4)))))
        for _ in range(20)
    ]
    squares = np.mean(np.square(found), axis=0)
    assert np.sqrt(squares) == pytest.approx(dataclasses.astuple(CONTRAST), rel=0.15)


def test_planned_contrast_has_power_80() -> None:
    plan = plan_contrast(60.0, CONTRAST, partners=40)
    assert plan.detectable <= 60.0
    assert plan_contrast(60.0, CONTRAST, partners=40, contrasts=10).seeds > plan.seeds
    rng, shape = np.random.default_rng(9), (plan.seeds, plan.partners, plan.episodes)
    seen = [
        mean_test(*(returns.mean(axis=2) for returns in two_pilots(rng, shape, 60.0))).p < 0.05
        for _ in range(500)
    ]
    assert 0.74 < np.mean(seen) < 0.88  # whole episodes see somewhat more than was asked for


def test_undetectable_contrast_is_refused() -> None:
    with pytest.raises(ValueError, match=r"64 seeds with 59 partners see \d+\.\d"):
        plan_contrast(1.0, CONTRAST)
    with pytest.raises(ValueError, match="an effect above 0"):
        plan_contrast(0.0, CONTRAST)
