"""Share of lists in which labs that pick by scores stand above equal ones, and its price.

Six methods play in made-up worlds, as in docs/tables/ranks.csv. One lab trains more seeds than it
shows. A list is wrong if it puts any method above another although all are equal.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np

METHODS, PARTNERS = 6, 30
GAP, SEED, EASE, PAIRS = 100.0, 40.0, 50.0, 2.0  # points of return; see `World`
SEEDS = (2, 3, 5, 10)  # of an entry
Scores = list[np.ndarray]  # [S, P] of each method


@dataclasses.dataclass
class World:
    """Made-up scores: the sum of the method's mean, the partner, the seed and the pairs' luck.

    Standard deviations in points of return: 40 between seeds of one method, 50 between partners, 2
    of a method or a seed with single partners.
    """

    rng: np.random.Generator
    gap: float = 0.0  # between the means of neighbours

    def entries(self, count: int, seeds: int) -> Scores:
        """Return the scores [S, P] of entries with the same partners."""
        ease = self.rng.normal(0, EASE, PARTNERS)
        return [
            self.play(index * self.gap + SEED * self.rng.normal(size=seeds)) + ease
            for index in range(count)
        ]

    def play(self, luck: np.ndarray) -> np.ndarray:
        """Return the scores [S, P] of seeds whose means are `luck` [S], partners left out."""
        pairs = PAIRS * self.rng.normal(size=(len(luck) + 1, PARTNERS))
        return luck[:, None] + pairs[:-1] + pairs[-1]


def best(scores: Scores, count: int) -> Scores:
    """Return the entries with the highest means."""
    return sorted(scores, key=lambda entry: -float(entry.mean()))[:count]


def honest(world: World, seeds: int) -> tuple[Scores, int]:
    """Six labs declare one entry each."""
    return world.entries(METHODS, seeds), 0


def pick_seeds(world: World, seeds: int) -> tuple[Scores, int]:
    """One lab shows the best of four times as many single robots as one method."""
    scores = world.entries(METHODS - 1 + 4, seeds)
    robots = np.concatenate(scores[METHODS - 1 :])
    chosen = robots[np.argsort(-robots.mean(axis=1))[:seeds]]
    return [*scores[: METHODS - 1], chosen], 0


def keep_entries(world: World, seeds: int) -> tuple[Scores, int]:
    """One lab declares twenty entries under other names; all of them stay."""
    return world.entries(METHODS - 1 + 20, seeds), 0


def drop_entries(world: World, seeds: int) -> tuple[Scores, int]:
    """One lab declares twenty entries, and all but the best break down, uncounted."""
    scores = world.entries(METHODS - 1 + 20, seeds)
    return [*scores[: METHODS - 1], *best(scores[METHODS - 1 :], 1)], 0


def drop_counted(world: World, seeds: int) -> tuple[Scores, int]:
    """As `drop_entries`, on a board that counts the entries that have no place."""
    return drop_entries(world, seeds)[0], 19


def choose_for_season(world: World, seeds: int) -> tuple[Scores, int]:
    """One lab has four entries in a season, and the best two by public scores play panel B."""
    luck = [SEED * world.rng.normal(size=seeds) for _ in range(METHODS - 1 + 4)]
    public = [float(world.play(entry).mean()) for entry in luck[METHODS - 1 :]]
    chosen = [luck[METHODS - 1 + index] for index in np.argsort(public)[-2:]]
    ease = world.rng.normal(0, EASE, PARTNERS)
    return [world.play(entry) + ease for entry in (*luck[: METHODS - 1], *chosen)], 2


# What is played, and whether the board's rules allow it.
CASES: dict[str, tuple[Callable[[World, int], tuple[Scores, int]], bool]] = {
    "honest": (honest, True),
    "best seeds of 4 times as many": (pick_seeds, False),
    "20 entries of one lab, all stay": (keep_entries, True),
    "best of 20 entries, the others uncounted": (drop_entries, False),
    "best of 20 entries, the others counted": (drop_counted, True),
    "best 2 of 4 entries play panel B": (choose_for_season, True),
}


def measure_picking(lists: int, seeds: tuple[int, ...] = SEEDS) -> list[dict[str, Any]]:
    """Return one row a case: shares of wrong lists, and of true orders found, by number of seeds.

    Args:
        lists: Made-up lists of each case and number of seeds.
        seeds: Numbers of seeds of an entry.
    """
    rows: list[dict[str, Any]] = [
        {"case": case, "allowed": allowed, "measure": "lists wrong"}
        | {str(count): wrong_share(play, count, lists) for count in seeds}
        for case, (play, allowed) in CASES.items()
    ]
    for unseen in (0, 2, 19):
        case = f"{unseen} other entries have no place"
        found = {str(count): order_share(count, lists, unseen) for count in seeds}
        rows.append({"case": case, "allowed": True, "measure": "orders found"} | found)
    return rows


def wrong_share(
    play: Callable[[World, int], tuple[Scores, int]], seeds: int, lists: int, seed: int = 0
) -> float:
    """Return the share of lists that put a method above an equal one."""
    from evaluation.figures.metrics import rank_methods

    world, wrong = World(np.random.default_rng(seed)), 0
    for _ in range(lists):
        scores, unseen = play(world, seeds)
        wrong += bool(rank_methods(scores, seed_sd=SEED, unseen=unseen).better.any())
    return wrong / lists


def order_share(seeds: int, lists: int, unseen: int = 0, seed: int = 0) -> float:
    """Return the share of true orders found among six honest methods, 100 apart."""
    from evaluation.figures.metrics import rank_methods

    world = World(np.random.default_rng(seed), GAP)
    found = [
        rank_methods(world.entries(METHODS, seeds), seed_sd=SEED, unseen=unseen).better[
            np.tril_indices(METHODS, -1)
        ]
        for _ in range(lists)
    ]
    return float(np.mean(found))
