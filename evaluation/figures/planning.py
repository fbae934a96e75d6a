"""How many seeds, partners and episodes an interval of a wished width takes.

A return J of seed s with partner p, a mean over K episodes, is taken for the sum of a mean, an
effect of the seed, one of the partner, one of the pair, and over K the luck of the partner's
starts, which all seeds meet, and the rest of the episodes' noise. With their variances the variance
of the bootstrap's mean is known before anything is played: of S seeds and P partners, with
a = 1 - 1/S and b = 1 - 1/P, it is in expectation

    a seeds^2 / S  +  b (partners^2 + starts^2 / K) / P
        +  (a b + a + b) (pairs^2 + episodes^2 / K) / (S P),

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
    episodes: float  # of one pair, beside its start
    starts: float = 0.0  # of a partner's starts, which all seeds meet

    def half_width(self, seeds: int, partners: int, episodes: int) -> float:
        """Return half the width of the 95% interval of M_test's mean."""
        a, b = 1 - 1 / seeds, 1 - 1 / partners
        noise = self.pairs**2 + self.episodes**2 / episodes
        column = self.partners**2 + self.starts**2 / episodes
        return Z * math.sqrt(
            a * self.seeds**2 / seeds
            + b * column / partners
            + (a * b + a + b) * noise / (seeds * partners)
        )


# Of the egos of docs/data/v1 with test partners, trained with 16 seeds. All partners had the same
# starts there, which no difference shows: the starts' share of an episode's variance is that of
# eight IPPO and six MASAC robots of d1 with starts of each partner's own (docs/advice.md).
MEASURED: dict[str, dict[str, Spread]] = {
    "scratch": {
        "ppo": Spread(0.8, 3.8, 0.0, 18.6, 7.8),
        "sac": Spread(8.8, 5.1, 8.9, 37.6, 16.7),
    },
    "bed_bath": {
        "ppo": Spread(17.1, 4.5, 35.9, 25.1, 1.1),
        "sac": Spread(16.7, 9.7, 36.7, 25.3, 1.6),
    },
    "arm_assist": {
        "ppo": Spread(187.7, 124.9, 203.9, 286.8, 99.8),
        "sac": Spread(2242.1, 26.8, 126.5, 234.0, 16.6),
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
    """Return where the returns of an episode table vary, by analyses of variance.

    Args:
        episodes: Columns `ego`, `partner`, `episode`, `return`: every ego with every partner in the
            same episodes, at least two egos and two partners.

    Raises:
        ValueError: It is not such a table.

    Examples:
        >>> columns = {"ego": "aabb", "partner": "xyxy", "return": [1.0, 2.0, 3.0, 5.0]}
        >>> pilot = pl.DataFrame({name: list(values) for name, values in columns.items()})
        >>> round(measure_spread(pilot.with_columns(episode=0)).seeds, 2)
        1.73
    """
    axes = ("ego", "partner", "episode")
    shape = tuple(episodes[name].n_unique() for name in axes)
    distinct = episodes.select(axes).n_unique()
    if not (episodes.height == distinct == math.prod(shape)) or min(shape[:2]) < 2:
        raise ValueError(
            "the spread needs every ego with every partner in the same episodes, and two of each "
            f"at least; here are {shape[0]} egos, {shape[1]} partners, {shape[2]} episodes and "
            f"{episodes.height} rows"
        )
    returns = episodes.sort(axes)["return"].to_numpy().reshape(shape).astype(float)
    noise, starts = _within_partners(returns) if shape[2] > 1 else (0.0, 0.0)
    return spread_of(returns.mean(axis=2), shape[2], noise, starts)


def spread_of(scores: np.ndarray, episodes: int, noise: float, starts: float) -> Spread:
    """Return the spread of scores [S, P].

    A mean square of the analysis of variance is in expectation a sum of the variances that it
    holds; they are solved for from the last to the first, and a negative one is 0.

    Args:
        scores: Means over the episodes of each pair.
        episodes: How many.
        noise: Variance of an episode beside its start.
        starts: Variance by a partner's starts; 0 where all partners had the same, which no
            difference between scores shows.
    """
    (s, p), scores = scores.shape, scores.astype(float)
    rows = scores.mean(axis=1, keepdims=True) - scores.mean()
    columns = scores.mean(axis=0, keepdims=True) - scores.mean()
    left = scores - scores.mean() - rows - columns
    residual = (left**2).sum() / ((s - 1) * (p - 1))
    variances = (
        rows.var() * s / (s - 1) - residual / p,
        columns.var() * p / (p - 1) - residual / s - starts / episodes,
        residual - noise / episodes,
        noise,
        starts,
    )
    return Spread(*(math.sqrt(max(float(variance), 0.0)) for variance in variances))


def _within_partners(returns: np.ndarray) -> tuple[float, float]:
    """Return the variances of the noise and of the starts of returns [S, P, K], K > 1."""
    s, p, k = returns.shape
    centred = returns - returns.mean(axis=2, keepdims=True)
    by_start = centred.mean(axis=0)
    noise = ((centred - by_start) ** 2).sum() / ((s - 1) * p * (k - 1))
    starts = (by_start**2).sum() / (p * (k - 1)) - noise / s
    return float(noise), max(float(starts), 0.0)


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
        reached = round(spread.half_width(seeds, partners, episodes), 2)
        return EvaluationPlan(seeds, partners, episodes, reached)

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
    return next(candidate for candidate in plans if candidate.half_width <= half_width)
