"""Plan the seeds and episodes that an interval of a given width, or a contrast, needs.

A return J of seed s with partner p, a mean over K episodes, is taken for the sum of a mean, an
effect of the seed, one of the partner, one of the pair, and over K the luck of the partner's
starts, which all seeds meet, and the rest of the episodes' noise. With their variances the variance
of the bootstrap's mean is known before anything is played: of S seeds and P partners, with
a = 1 - 1/S and b = 1 - 1/P, it is in expectation

    a seeds^2 / S  +  b (partners^2 + starts^2 / K) / P
        +  (a b + a + b) (pairs^2 + episodes^2 / K) / (S P),

the variance under resampled rows and columns (Owen, The pigeonhole bootstrap, 2007). With a single
seed nothing of new seeds is in it, as nothing of them is in the interval.

A contrast is a difference of two methods with the same partners in the same episodes: what a
partner brings to both cancels, and of partners only how the methods differ with them is left. With
S seeds of either method the variance of its mean is

    2 seeds^2 / S  +  partners^2 / P  +  2 (pairs^2 + episodes^2 / K) / (S P).
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
import polars as pl

from assistax_envs.registered import ByTask
from evaluation.figures.metrics.inference import POWER, MeanTest
from evaluation.figures.metrics.variance import Spread, measure_spread

EPISODES = 32  # of a pair at most: more cost much and buy little
SEEDS = 64  # of a method at most


# Of the egos of docs/data/paper with test partners, trained with 16 seeds. All partners had the
# same starts there, which no difference shows: the starts' share of an episode's variance is that
# of eight IPPO and six MASAC robots of d1 with starts of each partner's own (docs/advice.md).
MEASURED: Mapping[str, Mapping[str, Spread]] = ByTask(
    lambda kind: {method: Spread(*values) for method, values in kind.spreads.items()},
    lambda kind: bool(kind.spreads),
)


@dataclasses.dataclass(frozen=True)
class EvaluationPlan:
    """A plan of an evaluation, and the half-width that its interval will have."""

    seeds: int
    partners: int
    episodes: int
    half_width: float


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
    spread = spread or MEASURED[task or next(iter(MEASURED))][method]

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


@dataclasses.dataclass(frozen=True)
class ContrastSpread:
    """Standard deviations of a difference of two methods, in the units of the return."""

    seeds: float  # of either method
    partners: float  # of the difference, from partner to partner
    pairs: float  # of either method
    episodes: float  # of one pair, beside its start, which both methods meet

    def test(self, seeds: int, partners: int, episodes: int) -> MeanTest:
        """Return the expected test of no difference for these numbers."""
        noise = 2 * (self.pairs**2 + self.episodes**2 / episodes) / (seeds * partners)
        parts = (2 * self.seeds**2 / seeds, self.partners**2 / partners, noise)
        freedoms = (2 * (seeds - 1), partners - 1, 2 * (seeds - 1) * (partners - 1))
        variance = sum(parts)
        lost = sum(part**2 / freedom for part, freedom in zip(parts, freedoms, strict=True))
        freedom = variance**2 / lost if lost else math.inf
        return MeanTest(0.0, math.sqrt(variance), freedom, 1.0)


@dataclasses.dataclass(frozen=True)
class ContrastPlan:
    """A plan of a contrast, and the true difference that it finds with a power of 80%."""

    seeds: int  # of either method
    partners: int
    episodes: int
    detectable: float


def measure_contrast(a: pl.DataFrame, b: pl.DataFrame) -> ContrastSpread:
    """Return the standard deviations of the difference of two methods, from a pilot of each.

    Args:
        a: Episode table of a method, in the form of `measure_spread`.
        b: Episode table of the other method, with the same partners and number of episodes.

    Raises:
        ValueError: The tables have another form or different partners.

    Examples:
        >>> columns = {"ego": "aabb", "partner": "xyxy", "return": [1.0, 2.0, 3.0, 5.0]}
        >>> pilot = pl.DataFrame({name: list(values) for name, values in columns.items()})
        >>> pilot = pilot.with_columns(episode=0)
        >>> measure_contrast(pilot, pilot).partners
        0.0
    """
    spreads = [measure_spread(table) for table in (a, b)]
    means = [
        table.group_by("partner").agg(pl.col("return").cast(pl.Float64).mean()).sort("partner")
        for table in (a, b)
    ]
    if means[0]["partner"].to_list() != means[1]["partner"].to_list():
        raise ValueError("the two pilots have different partners; evaluate both with the same")
    differences = (means[0]["return"] - means[1]["return"]).to_numpy()
    noise = sum(
        (spread.pairs**2 + spread.episodes**2 / table["episode"].n_unique())
        / table["ego"].n_unique()
        for spread, table in zip(spreads, (a, b), strict=True)
    )
    partners = math.sqrt(max(float(differences.var(ddof=1)) - noise, 0.0))
    seeds, pairs, episodes = (
        float(np.sqrt(np.mean([getattr(spread, name) ** 2 for spread in spreads])))
        for name in ("seeds", "pairs", "episodes")
    )
    return ContrastSpread(seeds, partners, pairs, episodes)


def plan_contrast(
    effect: float,
    spread: ContrastSpread,
    *,
    partners: int = 59,
    contrasts: int = 1,
    alpha: float = 0.05,
) -> ContrastPlan:
    """Return the fewest seeds, then the fewest episodes, that detect a difference.

    A true difference of `effect` is then detected in 80% of repetitions, in a two-sided test at
    alpha / contrasts, which is Holm's strictest step.

    Args:
        effect: The true difference of the two methods' returns.
        spread: Of their difference, see `measure_contrast`.
        partners: Test partners that will be played.
        contrasts: Number of contrasts that are tested together.
        alpha: Chance of any false detection.

    Raises:
        ValueError: No number of seeds detects it with these partners; the message has the least
            detectable difference.

    Examples:
        >>> plan_contrast(60.0, ContrastSpread(45.0, 60.0, 20.0, 90.0), contrasts=8)
        ContrastPlan(seeds=20, partners=59, episodes=8, detectable=59.99)
    """
    if contrasts < 1 or not 0 < alpha < 1 or partners < 2 or not effect > 0:
        raise ValueError(
            f"effect is {effect}, contrasts {contrasts}, alpha {alpha}, partners {partners}; "
            "allowed are an effect above 0, 1 contrast or more, an alpha between 0 and 1, and 2 "
            "partners or more"
        )

    def plan(seeds: int, episodes: int) -> ContrastPlan:
        seen = spread.test(seeds, partners, episodes).detectable(alpha / contrasts, POWER)
        return ContrastPlan(seeds, partners, episodes, round(seen, 2))

    enough = [n for n in range(2, SEEDS + 1) if plan(n, EPISODES).detectable <= effect]
    if not enough:
        least = plan(SEEDS, EPISODES).detectable
        raise ValueError(
            f"effect is {effect}, and {SEEDS} seeds with {partners} partners see {least}; ask for "
            "more than that, name fewer contrasts, or play more partners"
        )
    plans = (plan(enough[0], episodes) for episodes in range(1, EPISODES + 1))
    return next(candidate for candidate in plans if candidate.detectable <= effect)
