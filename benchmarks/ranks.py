"""How often a list of ranks is wrong, and how much of the true order it finds, in made-up worlds.

A score is mean + ease of the partner + luck of the seed + what the method has with the partner +
what the seed has with it. In `even` worlds all methods are equal, and a list is wrong if any
method's range excludes rank 1; in the `order` world they are 100 apart, and the share of true
orders is counted.
"""

import dataclasses
import glob
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from evaluation.figures.metrics.ranks import Ranks, rank_methods

METHODS = 6
GAP, SEED, EASE = 100.0, 40.0, 50.0  # points of return
SEEDS = (1, 2, 3, 4, 5, 10)
KNOWN: Mapping[str, float | None] = {"nothing": None, "40": SEED, "20": SEED / 2, "80": 2 * SEED}


@dataclasses.dataclass(frozen=True)
class World:
    """Where scores come from; standard deviations in points of return."""

    partners: int = 30
    gap: float = 0.0  # between the means of neighbours
    seeds: tuple[float, ...] = (SEED,) * METHODS  # between the seeds of each method
    pairs: float = 2.0  # between a method's, and a seed's, values with partners
    heavy: bool = False  # Student's t with 3 degrees of freedom in place of normal

    def draw(self, seeds: int, rng: np.random.Generator) -> list[np.ndarray]:
        """Return the scores [S, P] of each method."""
        ease = rng.normal(0, EASE, self.partners)
        # A single robot is itself the method: its luck is no error.
        spreads = self.seeds if seeds > 1 else (0.0,) * len(self.seeds)
        return [
            index * self.gap
            + ease
            + spread * self._noise((seeds, 1), rng)
            + self.pairs * self._noise((1, self.partners), rng)
            + self.pairs * self._noise((seeds, self.partners), rng)
            for index, spread in enumerate(spreads)
        ]

    def _noise(self, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
        return rng.standard_t(3, shape) / np.sqrt(3) if self.heavy else rng.normal(size=shape)


EVEN = {
    "30 partners": World(),
    "200 partners": World(partners=200),
    "pairs differ too": World(pairs=120.0),
    "heavy tails": World(pairs=120.0, heavy=True),
    "heavy tails of seeds": World(heavy=True),
    "one bad row, x 3": World(seeds=(3 * SEED, *(SEED,) * (METHODS - 1))),
    "one bad row, x 10": World(seeds=(10 * SEED, *(SEED,) * (METHODS - 1))),
    "half the rows, x 1/5": World(seeds=(SEED / 5, SEED / 5, SEED / 5, SEED, SEED, SEED)),
}
ORDER = {
    "30 partners": World(gap=GAP),
    "200 partners": World(gap=GAP, partners=200),
    "pairs differ too": World(gap=GAP, pairs=120.0),
    "heavy tails": World(gap=GAP, pairs=120.0, heavy=True),
}


@dataclasses.dataclass(frozen=True)
class Row:
    """One figure of one world: a share by the number of seeds."""

    figure: str  # "wrong lists", "orders found" or "moved by an odd row"
    world: str
    known: str  # what the ranking is told of the seeds' standard deviation
    shares: dict[int, float]


def simulate(lists: int, seed: int = 0) -> Iterator[Row]:
    """Yield the table's rows; `lists` are drawn for each figure."""
    for name, known in KNOWN.items():
        for world, drawn in EVEN.items():
            yield Row("wrong lists", world, name, _shares(_wrong, drawn, known, lists, seed))
        for world, drawn in ORDER.items():
            yield Row("orders found", world, name, _shares(_found, drawn, known, lists, seed))
        moved = _shares(_moved, World(gap=GAP), known, lists, seed)
        yield Row("moved by an odd row", "30 partners", name, moved)


def measure_seed_sds(folder: Path) -> dict[str, list[float]]:
    """Return, by task, the standard deviation between seeds of each ego whose pairs are kept there.

    What chance between seeds and partners adds to it is taken off.
    """
    seed_sds: dict[str, list[float]] = {}
    for path in sorted(glob.glob(f"{folder}/v*/egos/**/pairs.parquet", recursive=True)):
        parts = Path(path).relative_to(folder).parts
        if "series" in parts[-2]:  # played in another way
            continue
        task = parts[2].rsplit("-", 1)[0] if len(parts) == 4 else parts[2]
        scores = _matrix(pl.read_parquet(path))
        if len(scores) > 1:
            seed_sds.setdefault(task, []).append(_seed_sd(scores))
    return seed_sds


def root_mean_square(values: Sequence[float]) -> float:
    """Return the mean that the larger values count more in."""
    return float(np.sqrt(np.mean(np.square(values))))


_Share = Callable[[World, int, float | None, np.random.Generator], float]


def _shares(
    share: _Share, world: World, known: float | None, lists: int, seed: int
) -> dict[int, float]:
    rng = np.random.default_rng(seed)
    return {
        seeds: float(np.mean([share(world, seeds, known, rng) for _ in range(lists)]))
        for seeds in SEEDS
    }


def _wrong(world: World, seeds: int, known: float | None, rng: np.random.Generator) -> float:
    ranks = rank_methods(world.draw(seeds, rng), seed_sd=known)
    return float((ranks.places > 1).any())


def _found(world: World, seeds: int, known: float | None, rng: np.random.Generator) -> float:
    ranks = rank_methods(world.draw(seeds, rng), seed_sd=known)
    return float(_true_orders(ranks).mean())


def _moved(world: World, seeds: int, known: float | None, rng: np.random.Generator) -> float:
    """Return the share of orders that are lost when a row of two unlike robots joins the list."""
    scores = world.draw(seeds, rng)
    odd = scores[0][:1] + np.array([[0.0], [1000.0]])
    without, joined = (rank_methods(rows, seed_sd=known) for rows in (scores, [*scores, odd]))
    return float(_true_orders(without).mean() - _true_orders(joined).mean())


def _true_orders(ranks: Ranks) -> np.ndarray:
    return ranks.better[:METHODS, :METHODS][np.tril_indices(METHODS, -1)]


def _matrix(pairs: pl.DataFrame) -> np.ndarray:
    ego = "ego" if "ego" in pairs.columns else "ego_seed"
    means = pairs.group_by(ego, "partner").agg(pl.col("return").mean()).sort(ego, "partner")
    return means["return"].to_numpy().reshape(means[ego].n_unique(), -1)


def _seed_sd(scores: np.ndarray) -> float:
    rest = scores - scores.mean(1, keepdims=True) - scores.mean(0) + scores.mean()
    seeds, partners = scores.shape
    of_pairs = np.square(rest).sum() / ((seeds - 1) * (partners - 1))
    variance = scores.mean(axis=1).var(ddof=1) - of_pairs / partners
    return float(np.sqrt(max(variance, 0.0)))
