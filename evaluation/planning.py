"""How many seeds, partners and episodes an interval of a wished width takes.

A return J of seed s with partner p, a mean over K episodes, is taken for the sum of a mean, an
effect of the seed, one of the partner, one of the pair, and the episodes' noise over K. With their
variances the variance of the bootstrap's mean is known before anything is played: of S seeds and P
partners, with a = 1 - 1/S and b = 1 - 1/P, it is in expectation

    a seeds^2 / S  +  b partners^2 / P  +  (a b + a + b) (pairs^2 + episodes^2 / K) / (S P),

the variance under resampled rows and columns (Owen, The pigeonhole bootstrap, 2007). With a single
seed nothing of new seeds is in it, as nothing of them is in the interval.
"""

import dataclasses
import math
import statistics

import numpy as np
import polars as pl

EPISODES = 32  # of a pair at most: more cost much and buy little
SEEDS = 64  # of a method at most
Z = statistics.NormalDist().inv_cdf(0.975)


@dataclasses.dataclass(frozen=True)
class Spread:
    """Standard deviations of a return, in its units, by what they come from."""

    seeds: float
    partners: float
    pairs: float  # who meets whom, beyond what seed and partner bring
    episodes: float  # of one pair

    def half_width(self, seeds: int, partners: int, episodes: int) -> float:
        """Return half the width of the 95% interval of M_test's mean."""
        a, b = 1 - 1 / seeds, 1 - 1 / partners
        noise = self.pairs**2 + self.episodes**2 / episodes
        return Z * math.sqrt(
            a * self.seeds**2 / seeds
            + b * self.partners**2 / partners
            + (a * b + a + b) * noise / (seeds * partners)
        )


# Of the egos of docs/data/v1 with test partners, trained with 16 seeds.
MEASURED: dict[str, dict[str, Spread]] = {
    "scratch": {"ppo": Spread(0.8, 3.8, 0.0, 20.1), "sac": Spread(8.8, 5.1, 7.8, 41.1)},
    "bed_bath": {"ppo": Spread(17.1, 4.5, 35.9, 25.1), "sac": Spread(16.7, 9.7, 36.7, 25.3)},
    "arm_assist": {
        "ppo": Spread(187.7, 124.9, 202.3, 303.7),
        "sac": Spread(2242.1, 26.8, 126.4, 234.6),
    },
}


@dataclasses.dataclass(frozen=True)
class EvaluationPlan:
    """What to play, and the interval that it will give."""

    seeds: int
    partners: int
    episodes: int
    half_width: float


def measure_spread(episodes: pl.DataFrame) -> Spread:
    """Return where the returns of an episode table vary, by the analysis of variance of two ways.

    Args:
        episodes: Columns `ego`, `partner`, `return`: every ego with every partner, equally often,
            at least two of each.

    Raises:
        ValueError: It is not such a table.

    Examples:
        >>> columns = {"ego": "aabb", "partner": "xyxy", "return": [1.0, 2.0, 3.0, 5.0]}
        >>> pilot = pl.DataFrame({name: list(values) for name, values in columns.items()})
        >>> round(measure_spread(pilot).seeds, 2)
        1.73
    """
    pairs = episodes.group_by("ego", "partner").agg(
        mean=pl.col("return").mean(), sd=pl.col("return").std(), n=pl.len()
    )
    shape = pairs["ego"].n_unique(), pairs["partner"].n_unique()
    if pairs.height != math.prod(shape) or pairs["n"].n_unique() > 1 or min(shape) < 2:
        raise ValueError(
            "the spread needs every ego with every partner, equally often, and two of each at "
            f"least; here are {shape[0]} egos, {shape[1]} partners and {pairs.height} pairs"
        )
    table = pairs.sort("ego", "partner")
    scores, deviations = (
        table[name].fill_null(0.0).to_numpy().reshape(shape) for name in ("mean", "sd")
    )
    return spread_of(scores, deviations, int(table["n"][0]))


def spread_of(scores: np.ndarray, deviations: np.ndarray, episodes: int) -> Spread:
    """Return the spread of scores [S, P], means over episodes, with their deviations [S, P]."""
    (s, p), scores = scores.shape, scores.astype(float)
    rows = scores.mean(axis=1, keepdims=True) - scores.mean()
    columns = scores.mean(axis=0, keepdims=True) - scores.mean()
    left = scores - scores.mean() - rows - columns
    residual = (left**2).sum() / ((s - 1) * (p - 1))
    noise = float((deviations.astype(float) ** 2).mean()) if episodes > 1 else 0.0
    variances = (
        (rows.var() * s / (s - 1)) - residual / p,
        (columns.var() * p / (p - 1)) - residual / s,
        residual - noise / episodes,
        noise,
    )
    return Spread(*(math.sqrt(max(float(one), 0.0)) for one in variances))


def plan_evaluation(
    half_width: float,
    *,
    task: str | None = None,
    method: str = "ppo",
    spread: Spread | None = None,
    partners: int = 59,
) -> EvaluationPlan:
    """Return the fewest seeds, then the fewest episodes, that give an interval of this half-width.

    Seeds come first because each has to be trained; partners of a split cost next to nothing.

    Args:
        half_width: Half of M_test's 95% interval, in units of the return.
        task: Task of release v1 whose measured spread is taken where `spread` is not given.
        method: "ppo" or "sac", of which it was measured.
        spread: A spread of one's own, such as `measure_spread(pilot.episodes)`.
        partners: Test partners that will be played; v1 has 99 of scratch, else 59.

    Raises:
        ValueError: No number of seeds reaches it with these partners; it says what is reached.

    Examples:
        >>> plan_evaluation(10.0, spread=Spread(17.1, 4.5, 35.9, 25.1))
        EvaluationPlan(seeds=13, partners=59, episodes=11, half_width=10.0)
        >>> plan_evaluation(2.0, task="scratch", partners=99)
        EvaluationPlan(seeds=2, partners=99, episodes=6, half_width=1.94)
    """
    spread = spread or MEASURED[task or "scratch"][method]

    def plan(seeds: int, episodes: int) -> EvaluationPlan:
        found = round(spread.half_width(seeds, partners, episodes), 2)
        return EvaluationPlan(seeds, partners, episodes, found)

    # One seed has an interval too, which does not speak of new seeds: that is no plan for a method.
    enough = [n for n in range(2, SEEDS + 1) if plan(n, EPISODES).half_width <= half_width]
    if not enough:
        least = plan(SEEDS, EPISODES).half_width
        raise ValueError(
            f"half_width is {half_width}, and {SEEDS} seeds with {partners} partners reach "
            f"{least}; ask for more than that, or compare two methods on the same episodes, whose "
            "difference varies less"
        )
    plans = (plan(enough[0], episodes) for episodes in range(1, EPISODES + 1))
    return next(one for one in plans if one.half_width <= half_width)
