"""Return and success of robots over the parameters ("numbers") of persons.

A person's outcome is its mean over egos and episodes; persons are resampled. For each number,
persons are grouped into bins of equal counts. The effect of a number is the share of the variance
of persons' outcomes between the bins, corrected for chance (omega squared, Kirk 1996):
(SS_between - (B - 1) MS_within) / (SS_all + MS_within). Its interval is a basic bootstrap over
persons, because resampling adds ties, which look like an effect. `chance` is the 95% quantile of
the largest effect of all numbers if outcomes are shuffled among persons.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl
from jaxtyping import Float, Int

from assistax_envs.persons.rows import PARAMETERS
from evaluation.record.record import Record
from zoo.partners.kinds import described_kind

BINS = 5
RESAMPLES, SHUFFLES = 1000, 200
FEWEST = 4  # persons for each bin, so that it has a mean worth reading
RETURN, SUCCESS = "return", "success"


@dataclasses.dataclass(frozen=True)
class Outcomes:
    """Outcomes and numbers of the P persons of a folder."""

    task: str
    rows: Float[np.ndarray, "P W"]
    values: dict[str, Float[np.ndarray, " P"]]  # mean return and share of (caring) success
    episodes: int
    egos: int


@dataclasses.dataclass(frozen=True)
class Effect:
    """Effect of one number on one outcome."""

    parameter: str
    unit: str
    share: float  # of the variance of persons' outcomes; below 0 if smaller than expected by chance
    share_ci: tuple[float, float]
    low_to_high: float  # mean of the highest bin minus that of the lowest
    low_to_high_ci: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Surface:
    """Mean outcomes over two numbers; a cell is [bin of x][bin of y], None without persons."""

    x: str
    y: str
    x_edges: tuple[float, ...]
    y_edges: tuple[float, ...]
    count: list[list[int]]
    values: dict[str, list[list[float | None]]]


def outcomes(record: Record) -> Outcomes:
    """Return the outcomes of a folder's persons, without its other partners.

    Raises:
        ValueError: No partner is a person, or persons are of several tasks.
    """
    table = record.table
    means = (
        table.group_by("partner", maintain_order=True)
        .agg(pl.col(RETURN).cast(pl.Float64).mean(), pl.col(SUCCESS).cast(pl.Float64).mean())
        .sort("partner")
    )
    names = means["partner"].to_list()
    try:
        task, known, rows = described_kind().numbers(names)
    except ValueError as error:
        raise ValueError(f"{record.folder} has {error}") from None
    played = means.filter(pl.Series(known))
    mine = table.filter(pl.col("partner").is_in(played["partner"].to_list()))
    values = {name: played[name].to_numpy() for name in (RETURN, SUCCESS)}
    return Outcomes(task, rows, values, mine.height, mine["ego"].n_unique())


def effects(
    of: Outcomes, outcome: str, *, bins: int = BINS, resamples: int = RESAMPLES, seed: int = 0
) -> tuple[list[Effect], float]:
    """Return each number's effect on an outcome, the largest share first, and `chance`.

    Raises:
        ValueError: There are too few persons for so many bins.
    """
    values, rng = of.values[outcome], np.random.default_rng(seed)
    if bins < 2 or len(values) < FEWEST * bins:
        raise ValueError(
            f"{len(values)} persons in {bins} bins; give 2 bins or more, and {FEWEST} persons for "
            "each at least"
        )
    dealt = [_binned(column, bins)[0] for column in of.rows.T]
    draws = rng.integers(0, len(values), (resamples, len(values)))
    measured = [
        _effect(parameter, groups, values, draws)
        for parameter, groups in zip(PARAMETERS[of.task], dealt, strict=True)
    ]
    shuffled = np.stack([rng.permutation(values) for _ in range(SHUFFLES)])
    largest = np.max([_share(np.broadcast_to(g, shuffled.shape), shuffled) for g in dealt], axis=0)
    return sorted(measured, key=lambda effect: -effect.share), float(np.quantile(largest, 0.95))


def surface(of: Outcomes, over: tuple[str, str], *, bins: int = BINS) -> Surface:
    """Return the outcomes over two numbers, each in bins of equal counts of persons.

    Raises:
        ValueError: There is no such number, or it is twice the same.
    """
    names = [parameter.name for parameter in PARAMETERS[of.task]]
    for name in over:
        if name not in names:
            raise ValueError(f"parameter is {name!r}; allowed are {', '.join(names)}")
    if over[0] == over[1]:
        raise ValueError(f"the surface is over {over[0]} twice; name two parameters")
    (rows, x_edges), (columns, y_edges) = (
        _binned(of.rows[:, names.index(name)], bins) for name in over
    )
    shape = len(x_edges) - 1, len(y_edges) - 1
    cells = rows * shape[1] + columns
    count = np.bincount(cells, minlength=shape[0] * shape[1])
    sums = {
        name: np.bincount(cells, weights=values, minlength=count.size)
        for name, values in of.values.items()
    }
    means = {
        name: [
            part / n if n else None for part, n in zip(total.tolist(), count.tolist(), strict=True)
        ]
        for name, total in sums.items()
    }
    width = shape[1]
    return Surface(
        *over,
        tuple(x_edges.tolist()),
        tuple(y_edges.tolist()),
        count.reshape(shape).tolist(),
        {
            name: [values[start : start + width] for start in range(0, count.size, width)]
            for name, values in means.items()
        },
    )


def summarise_parameters(
    record: Record, over: Sequence[str] = (), *, bins: int = BINS, most: int = 5
) -> dict[str, Any]:
    """Return the numbers with the largest effects, and a surface over two numbers, JSON-ready.

    Args:
        record: The record of a folder whose partners are persons.
        over: Two numbers; by default the two with the largest effect on the return.
        bins: Number of bins of each number.
        most: Largest count of numbers to show.

    Raises:
        ValueError: The folder has no persons or too few, or they lack one of the numbers.
    """
    persons = outcomes(record)
    if len(over) not in (0, 2) or most < 1:
        raise ValueError(
            f"the surface is over {len(over)} parameters, and {most} are to be shown; name two or "
            "none for the surface, and show 1 or more"
        )
    measured = {outcome: effects(persons, outcome, bins=bins) for outcome in persons.values}
    matter = {
        outcome: {
            "chance": chance,
            "parameters": [dataclasses.asdict(effect) for effect in ordered[:most]],
        }
        for outcome, (ordered, chance) in measured.items()
    }
    first, second = over or (effect.parameter for effect in measured[RETURN][0][:2])
    return {
        "task": persons.task,
        "persons": len(persons.rows),
        "egos": persons.egos,
        "episodes": persons.episodes,
        "bins": bins,
        "means": {name: float(values.mean()) for name, values in persons.values.items()},
        "matter": matter,
        "surface": dataclasses.asdict(surface(persons, (first, second), bins=bins)),
    }


def _binned(
    column: Float[np.ndarray, " P"], bins: int
) -> tuple[Int[np.ndarray, " P"], Float[np.ndarray, " E"]]:
    """Return each person's bin and the bins' edges; persons without the number may have a bin."""
    edges = np.unique(np.quantile(column.astype(np.float64), np.linspace(0.0, 1.0, bins + 1)))
    if len(edges) < 2:
        edges = np.array([edges[0], edges[0]])
    return np.searchsorted(edges[1:-1], column, side="right"), edges


def _effect(
    parameter: Any, groups: np.ndarray, values: np.ndarray, draws: Int[np.ndarray, "B P"]
) -> Effect:
    last, share = int(groups.max()), float(_share(groups[None], values[None])[0])
    again = _share(groups[draws], values[draws])
    low, high = np.quantile(again, (0.025, 0.975))
    step = float(_low_to_high(groups[None], values[None], last)[0])
    steps = np.nanquantile(_low_to_high(groups[draws], values[draws], last), (0.025, 0.975))
    return Effect(
        parameter.name,
        parameter.unit,
        share,
        (float(2.0 * share - high), float(2.0 * share - low)),
        step,
        (float(steps[0]), float(steps[1])),
    )


def _share(groups: Int[np.ndarray, "B P"], values: Float[np.ndarray, "B P"]) -> np.ndarray:
    """Return omega squared [B] of values in groups; 0 if all values are equal."""
    count, total = _sums(groups, values)
    people = values.shape[1]
    middle = values.mean(axis=1, keepdims=True)
    all_ = ((values - middle) ** 2).sum(axis=1)
    means = total / np.maximum(count, 1)
    between = (count * (means - middle) ** 2).sum(axis=1)
    filled = (count > 0).sum(axis=1)
    within = (all_ - between) / np.maximum(people - filled, 1)
    return (between - (filled - 1) * within) / np.where(all_ + within > 0.0, all_ + within, 1.0)


def _low_to_high(groups: np.ndarray, values: np.ndarray, last: int) -> np.ndarray:
    """Return the mean of the last group minus that of the first [B]; NaN if one is empty."""
    count, total = _sums(groups, values)
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return means[:, last] - means[:, 0]


def _sums(groups: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the count and the sum of the values in each group, [B, G]."""
    size = int(groups.max()) + 1
    flat = (groups + size * np.arange(len(groups))[:, None]).ravel()
    count = np.bincount(flat, minlength=size * len(groups)).reshape(-1, size)
    total = np.bincount(flat, weights=values.ravel(), minlength=size * len(groups))
    return count, total.reshape(-1, size)
