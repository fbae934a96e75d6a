"""Variance components of returns: robots, partners, pairs, starts, and the rest of an episode."""

import dataclasses
import math
import statistics

import numpy as np
import polars as pl
from jaxtyping import Bool, Float, Num

Z = statistics.NormalDist().inv_cdf(0.975)


@dataclasses.dataclass(frozen=True)
class Spread:
    """Standard deviations of a return, in its units, by source."""

    seeds: float
    partners: float
    pairs: float  # interaction of seed and partner
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

    @property
    def interaction_index(self) -> float | None:
        """Share of pair effects in the variance between mean returns; None without variance.

        pairs^2 / (seeds^2 + partners^2 + pairs^2) is 0 if returns are sums of a robot's and a
        partner's effect, and 1 if all depends on the pair.
        """
        parts = (self.seeds**2, self.partners**2, self.pairs**2)
        return self.pairs**2 / sum(parts) if sum(parts) > 0 else None


@dataclasses.dataclass(frozen=True)
class Variance:
    """Variance components of the robots and partners of a table."""

    spread: Spread
    interaction_index: float | None  # see `Spread.interaction_index`
    # Of the F test that pairs differ by no more than their episodes do; None with one episode.
    interaction_p: float | None


def variance_components(
    returns: Num[np.ndarray, "E P K"], cells: Bool[np.ndarray, "E P"] | None = None
) -> Variance | None:
    """Return the variance components of returns, or None if there are too few pairs.

    Args:
        returns: Returns of E robots with P partners in the same K episodes.
        cells: Mask of the pairs to use, such as those not trained together; by default all.
    """
    from scipy import stats  # half a second, hence not at every start

    cells = np.ones(returns.shape[:2], bool) if cells is None else cells
    rows, columns = cells.any(axis=1), cells.any(axis=0)
    returns, cells = returns[rows][:, columns].astype(float), cells[rows][:, columns]
    (robots, partners), episodes = cells.shape, returns.shape[2]
    freedom = int(cells.sum()) - robots - partners + 1
    if min(robots, partners) < 2 or freedom < 1:
        return None
    noise, starts = _within_partners(returns, cells) if episodes > 1 else (0.0, 0.0)
    scores = returns.mean(axis=2)
    spread = spread_of(scores, episodes, noise, starts, cells)
    chance = None
    if episodes > 1 and noise > 0:
        residual = _left_of_both(scores, cells) / (cells.sum() - sum(cells.shape) + 1)
        ratio = residual * episodes / noise
        within = int((cells.sum(axis=0) - 1).sum()) * (episodes - 1)
        chance = float(stats.f.sf(ratio, freedom, within))
    return Variance(spread, spread.interaction_index, chance)


def measure_spread(episodes: pl.DataFrame) -> Spread:
    """Return the standard deviations of an episode table's returns by source, from ANOVA.

    Args:
        episodes: Columns `ego`, `partner`, `episode`, `return`: every ego with every partner in the
            same episodes, at least two egos and two partners.

    Raises:
        ValueError: The table has another form.

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


def spread_of(
    scores: Num[np.ndarray, "S P"],
    episodes: int,
    noise: float,
    starts: float,
    cells: Bool[np.ndarray, "S P"] | None = None,
) -> Spread:
    """Return the spread of scores by Henderson's third method.

    Of N cells in S rows and P columns, SSE(rows), SSE(columns) and SSE(both) are what is left after
    fitting effects of rows, of columns, or of both. Cells hold one score each, so

        residual  = SSE(both) / (N - S - P + 1)             = pairs^2 + episodes^2 / K
        SSE(columns) - SSE(both) - (S - 1) residual         = (N - P) seeds^2
        SSE(rows) - SSE(both) - (P - 1) residual            = (N - S) (partners^2 + starts^2 / K)

    in expectation. With all cells this is the analysis of variance of two crossed factors. A
    negative variance is 0. (Henderson 1953; Searle, Casella and McCulloch 1992, chapter 5.)

    Args:
        scores: Means over the episodes of each pair.
        episodes: How many, K.
        noise: Variance of an episode beside its start.
        starts: Variance by a partner's starts; 0 where all partners had the same, which no
            difference between scores shows.
        cells: Which scores count; default all.
    """
    cells = np.ones(scores.shape, bool) if cells is None else cells
    (s, p), n, scores = scores.shape, cells.sum(), scores.astype(float)
    both = _left_of_both(scores, cells)
    rows, columns = (_left_of_columns(*two) for two in ((scores.T, cells.T), (scores, cells)))
    residual = both / (n - s - p + 1)
    variances = (
        (columns - both - (s - 1) * residual) / (n - p),
        (rows - both - (p - 1) * residual) / (n - s) - starts / episodes,
        residual - noise / episodes,
        noise,
        starts,
    )
    return Spread(*(math.sqrt(max(float(variance), 0.0)) for variance in variances))


def _left_of_columns(scores: np.ndarray, cells: np.ndarray) -> float:
    """Return the sum of squares about the columns' means."""
    means = np.where(cells, scores, 0.0).sum(axis=0) / cells.sum(axis=0)
    return float((np.where(cells, scores - means, 0.0) ** 2).sum())


def _left_of_both(scores: np.ndarray, cells: np.ndarray) -> float:
    """Return the sum of squares about the least-squares effects of rows and columns."""
    counts, weights = cells.sum(axis=0), cells.astype(float)
    means = (weights * scores).sum(axis=0) / counts
    normal = np.diag(weights.sum(axis=1)) - (weights / counts) @ weights.T
    effects = np.linalg.lstsq(normal, (weights * (scores - means)).sum(axis=1), rcond=None)[0]
    return _left_of_columns(scores - effects[:, None], cells)


def _within_partners(
    returns: Float[np.ndarray, "E P K"], cells: Bool[np.ndarray, "E P"] | None = None
) -> tuple[float, float]:
    """Return the variances of the noise and of the starts, K > 1."""
    cells = np.ones(returns.shape[:2], bool) if cells is None else cells
    episodes, counts = returns.shape[2], cells.sum(axis=0)
    centred = np.where(cells[..., None], returns - returns.mean(axis=2, keepdims=True), 0.0)
    by_start = centred.sum(axis=0) / counts[:, None]
    apart = np.where(cells[..., None], centred - by_start, 0.0)
    noise = (apart**2).sum() / max((counts - 1).sum() * (episodes - 1), 1)
    starts = (by_start**2).sum() / (len(counts) * (episodes - 1)) - noise * (1 / counts).mean()
    return float(noise), max(float(starts), 0.0)
