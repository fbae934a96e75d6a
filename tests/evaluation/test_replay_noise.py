"""Differences of processors pass, and forged differences do not."""

import numpy as np
import polars as pl
import pytest

from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS
from evaluation.figures.normalised import RANDOM
from evaluation.replay.noise import (
    QUANTILES,
    hidden_bias,
    mean_tolerance,
    measured_columns,
    noise_problems,
    read_noise,
    wild,
)
from tools.replay_noise import measure_noise

EGOS, PARTNERS, EPISODES = 2, 9, 8


@pytest.fixture
def episodes() -> pl.DataFrame:
    """Return episodes of two robots with typical returns and all columns of a scratch table."""
    rng = np.random.default_rng(0)
    size = EGOS * PARTNERS * EPISODES
    row = np.arange(size)
    columns = {name: rng.normal(10, 1, size) for name in read_noise("scratch")}
    flags = {name: np.ones(size, bool) for name in ("success", "nonfinite")}
    return pl.DataFrame(
        {
            "ego": [f"robot{place}" for place in row // (PARTNERS * EPISODES)],
            "partner": [f"human{place}" for place in row // EPISODES % PARTNERS],
            "episode": row % EPISODES,
            "ego_seed": 0,
            "key": 7,
            **columns,
            **flags,
            "steps": 1000,
            "return": rng.normal(950, 100, size),
        }
    )


def raised(table: pl.DataFrame, rows: pl.Expr, by: float) -> pl.DataFrame:
    value = pl.when(rows).then(pl.col("return") * by).otherwise(pl.col("return"))
    return table.with_columns(value.alias("return"))


def test_noise_covers_all_tasks_and_columns() -> None:
    tasks = (*PAPER_TASKS, *GENTLE_TASKS)  # with nobody of the others anybody has played yet
    for task in [*tasks, *map(wild, tasks)]:
        noise = read_noise(task)
        assert {"return", "success", "force_mean", "steps", "nonfinite"} <= set(noise)
        for scale in noise.values():
            assert len(scale["quantiles"]) == len(QUANTILES)
            assert sorted(scale["quantiles"]) == scale["quantiles"]
            assert scale["rms"] <= scale["largest"]
    with pytest.raises(ValueError, match="never measured"):
        read_noise("juggling")


def test_processor_noise_passes(episodes: pl.DataFrame) -> None:
    """Last bits everywhere, a little in a tenth of the episodes, one that is wholly another."""
    rng = np.random.default_rng(1)
    gaps = rng.normal(0, 0.5, episodes.height)
    some = rng.random(episodes.height) < 0.1
    gaps[some] += rng.normal(0, 30, some.sum())
    gaps[5] = 450
    kept = episodes.with_columns(pl.col("return") + pl.Series(gaps))
    assert noise_problems("scratch", kept, episodes) == []


@pytest.mark.parametrize(
    ("rows", "by"),
    [
        (pl.col("ego") == "robot0", 1.05),
        (pl.col("ego") == "robot0", 0.95),
        (pl.col("ego") == "robot0", 1.0001),  # all to one side
        (pl.col("episode") < 5, 1.08),  # of most episodes
        (pl.col("episode") < 3, 1.3),  # of some, by much
        (pl.col("partner") == "human3", 1.25),
        ((pl.col("partner") == "human3") & (pl.col("ego") == "robot1"), 1.4),
    ],
)
def test_a_bias_is_found(episodes: pl.DataFrame, rows: pl.Expr, by: float) -> None:
    problems = noise_problems("scratch", raised(episodes, rows, by), episodes)
    assert problems and all(problem.startswith("return of ") for problem in problems)


@pytest.mark.slow
def test_every_column_is_compared(episodes: pl.DataFrame) -> None:
    for name in measured_columns(episodes):
        column = ~pl.col(name) if episodes[name].dtype == pl.Boolean else pl.col(name) * 1.5 + 400
        problems = noise_problems("scratch", episodes.with_columns(column), episodes)
        assert any(problem.startswith(f"{name} of ") for problem in problems), name
    strange = episodes.with_columns(term_bonus=pl.lit(1.0))
    assert "never measured" in noise_problems("scratch", strange, strange)[0]


@pytest.mark.parametrize("flag", ["success", "nonfinite"])
def test_false_flags_are_found_elsewhere(episodes: pl.DataFrame, flag: str) -> None:
    problems = noise_problems("scratch", episodes.with_columns(~pl.col(flag)), episodes)
    assert any(problem.startswith(f"{flag} of ") for problem in problems)


TEST_SIDE = pl.col("partner").is_in([f"human{place}" for place in range(5)])


def test_a_raised_side_is_not_balanced_by_another(episodes: pl.DataFrame) -> None:
    """All episodes, each robot, each partner and each pair alone would let it pass."""
    number = pl.col("partner").str.tail(1).cast(pl.Int64)
    by = pl.when(number < 3).then(960).when(number.is_in([5, 6, 7])).then(-960).otherwise(0)
    kept = episodes.with_columns(pl.col("return") + by * (pl.col("episode") == 0))
    assert noise_problems("scratch", kept, episodes) == []
    [problem] = noise_problems("scratch", kept, episodes, TEST_SIDE)
    assert problem.startswith("return of the headline figure: the mean of 80 episodes differs by")


@pytest.mark.parametrize("task", ["scratch", "bed_bath", "gentle_lift"])
@pytest.mark.parametrize("every", [1, 4])  # of the pairs' episodes, how many are there
def test_hidden_bias_is_the_most_that_passes(episodes: pl.DataFrame, task: str, every: int) -> None:
    """Of shifts of all shapes: a few episodes raised by much, or many by little."""
    columns = [name for name in episodes.columns if name in read_noise(task)]
    strange = set(measured_columns(episodes)) - set(columns)
    played = episodes.drop(strange).filter(pl.col("episode") % every == 0)
    rows = played.select(TEST_SIDE).to_series().to_numpy()
    most = hidden_bias(task, played, TEST_SIDE)
    assert most is not None and most >= mean_tolerance(read_noise(task)["return"], int(rows.sum()))

    def passes(raised: int, bias: float) -> bool:
        """Raise so many episodes of the figure, spread over it, and lower the others a little."""
        order = np.random.default_rng(0).permutation(np.flatnonzero(rows))
        gaps = np.where(np.arange(rows.size) % 2, -0.02, 0.02)
        gaps[order[:raised]] = bias * rows.sum() / raised
        kept = played.with_columns(pl.col("return") + pl.Series(gaps))
        return not noise_problems(task, kept, played, TEST_SIDE)

    shapes = [*range(1, 12), *range(12, int(rows.sum()) + 1, 8)]
    assert any(passes(raised, 0.95 * most) for raised in shapes)
    assert not any(passes(raised, 1.01 * most) for raised in shapes)


def test_hidden_bias_needs_replayed_episodes(episodes: pl.DataFrame) -> None:
    rest = episodes.filter(~TEST_SIDE)
    assert hidden_bias("scratch", rest, TEST_SIDE) is None
    noise_problems("scratch", rest, rest, TEST_SIDE)


def test_random_actions_have_a_scale_of_their_own(episodes: pl.DataFrame) -> None:
    """Their episodes all end otherwise elsewhere; beside them others are held to their own."""
    rng = np.random.default_rng(2)
    robot = pl.when(pl.col("ego") == "robot0").then(pl.lit(RANDOM)).otherwise(pl.col("ego"))
    played = episodes.with_columns(robot.alias("ego"))
    gaps = np.where(played["ego"] == RANDOM, rng.normal(0, 100, episodes.height), 0)
    kept = played.with_columns(pl.col("return") + pl.Series(gaps))
    assert noise_problems("scratch", kept, played) == []
    assert noise_problems("scratch", kept.with_columns(episodes["ego"]), episodes)
    assert noise_problems("scratch", raised(kept, pl.col("ego") == "robot1", 1.05), played)
    assert noise_problems("scratch", raised(kept, pl.col("ego") == RANDOM, 1.5), played)


def test_the_scale_is_that_of_the_wildest_robot(episodes: pl.DataFrame) -> None:
    """So that a robot which differs as those that were measured is not taken for forged."""
    other = raised(episodes, pl.col("ego") == "robot1", 1.1)
    scale = measure_noise(episodes, other)["return"]
    gaps = (other["return"] - episodes["return"]).filter(episodes["ego"] == "robot1").to_numpy()
    assert scale["largest"] == pytest.approx(gaps.max(), rel=0.1)
    assert scale["rms"] == pytest.approx(np.sqrt(np.mean(gaps**2)), rel=0.1)
    assert scale["quantiles"][0] == pytest.approx(np.median(gaps), rel=0.1)
    assert measure_noise(episodes, episodes)["return"]["rms"] == 0


def test_detectable_bias_matches_docs() -> None:
    """Of the mean return of one robot with 486 episodes, 27 partners times 18."""
    figures = {"scratch": 926, "bed_bath": 814, "arm_assist": 4232, "gentle_lift": 473}
    shares = [
        round(100 * mean_tolerance(read_noise(task)["return"], 486) / mean, 1)
        for task, mean in figures.items()
    ]
    assert shares == [2.7, 2.6, 1.0, 10.3]
