"""How far honest episodes lie apart on two kinds of processor, and whether a replay lies within.

Networks and rewards round differently where a processor has other instructions, and contacts
amplify last bits: most episodes end almost the same, a few wholly different. `replay_noise.json`
holds, by task and column, how far: from sixteen published robots with sixteen humans each, played
with and without fused multiply-adds (`python -m tools.replay_noise`). Nothing of the folder that
is judged enters the scale, so that no forger can widen it.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from evaluation.figures.normalised import RANDOM

QUANTILES = (0.5, 0.75, 0.9, 0.97)  # of the absolute differences of a robot's episodes
MARGIN = 2.0  # times what was measured of single episodes: a robot may be wilder than those
DEVIATIONS = 6.0  # of a mean: many groups and columns are looked at
ONE_SIDED = 5.0  # deviations of a coin's: of those measured, no group of any column had above 3.6
ROUNDING = 1e-5  # of a value: 32-bit sums of a thousand steps
FILE = Path(__file__).with_name("replay_noise.json")


def read_noise(task: str) -> dict[str, dict[str, Any]]:
    """Return what was measured of a task's columns: `quantiles`, `rms` and `largest`.

    Args:
        task: A task, or `wild(task)`.

    Raises:
        ValueError: Nothing was measured of it.
    """
    measured = json.loads(FILE.read_text())
    if task not in measured:
        raise ValueError(
            f"how far episodes of {task} differ between processors was never measured; replay the "
            "folder on the kind of processor that made it"
        )
    return measured[task]


def wild(task: str) -> str:
    """Return where the file has a task's uniformly random robot, whose episodes differ most."""
    return f"{task}/{RANDOM}"


def measured_columns(table: pl.DataFrame) -> list[str]:
    """Return the columns that come of playing, and not of the job."""
    planned = {"episode", "place", "key"}
    return [
        name
        for name, kind in table.schema.items()
        if (kind.is_numeric() or kind == pl.Boolean)
        and not name.endswith("_seed")
        and name not in planned
    ]


def noise_problems(
    task: str, kept: pl.DataFrame, played: pl.DataFrame, figure: pl.Expr | None = None
) -> list[str]:
    """Say where kept episodes lie farther from those played again than processors do.

    Of all episodes and of each robot's no more may lie beyond a quantile than did of the worst
    robot that was measured. Of these, of each partner's, of each pair's and of the headline
    figure's the mean difference must be within what so many episodes make.

    Args:
        task: Whose noise is meant.
        kept: The folder's episodes.
        played: The same, in the same order, played here.
        figure: Which of them the headline figure is the mean of; a forger who raises those could
            otherwise lower others in return.
    """
    of_random = kept["ego"] == RANDOM
    if of_random.any() and not of_random.all():
        parts = (
            (table.filter(rows) for table in (kept, played)) for rows in (of_random, ~of_random)
        )
        return [text for old, new in parts for text in noise_problems(task, old, new)]
    noise, problems = read_noise(wild(task) if of_random.all() else task), []
    for name in measured_columns(kept):
        scale = noise.get(name)
        if scale is None:
            problems.append(f"column {name} was never measured on two kinds of processor")
            continue
        signed = signed_gaps(kept, played, name)
        rounding = _rounding(played, name)
        for group, rows, of_robots in _every_group(kept, figure):
            far = of_robots and _beyond(np.abs(signed[rows]), rounding[rows], scale)
            if far:
                problems.append(f"{name} of {_named(group)}: {far}")
            if side := _one_sided(signed[rows], rounding[rows]):
                problems.append(f"{name} of {_named(group)}: {side}")
            mean, most = abs(signed[rows].mean()), _largest_mean(scale, rounding[rows])
            if mean > most:
                problems.append(
                    f"{name} of {_named(group)}: the mean of {len(rows)} episodes differs by "
                    f"{mean:.4g}, processors by less than {most:.4g}"
                )
    return problems


def hidden_bias(
    task: str, played: pl.DataFrame, figure: pl.Expr, name: str = "return"
) -> float | None:
    """Return the largest bias of a column's mean that `noise_problems` lets pass.

    It is that of a forger who changed all episodes of the figure alike, those that were not played
    too. None where none of them were played.

    Args:
        task: Whose noise is meant.
        played: Episodes that were played again.
        figure: Which of them the headline figure is the mean of.
        name: The column.
    """
    rows = _rows_of(played, figure)
    if not rows.size:
        return None
    return float(_largest_mean(read_noise(task)[name], _rounding(played, name)[rows]))


def _largest_mean(scale: dict[str, Any], rounding: np.ndarray) -> float:
    """Return the largest mean difference that passes, of a group with these roundings."""
    return mean_tolerance(scale, rounding.size) + rounding.mean()


def _rounding(played: pl.DataFrame, name: str) -> np.ndarray:
    """Return by how much a column's values may always differ."""
    return ROUNDING * (1 + np.abs(played[name].cast(pl.Float64).to_numpy()))


def mean_tolerance(scale: dict[str, Any], episodes: int) -> float:
    """Return how far the mean of so many episodes may lie from that on another processor."""
    return DEVIATIONS * scale["rms"] / np.sqrt(episodes) + MARGIN * scale["largest"] / episodes


def _beyond(gaps: np.ndarray, rounding: np.ndarray, scale: dict[str, Any]) -> str | None:
    """Say if more of a robot's episodes lie beyond a quantile than chance puts there."""
    n = len(gaps)
    for share, quantile in zip(QUANTILES, scale["quantiles"], strict=True):
        beyond = float(np.mean(gaps > MARGIN * quantile + rounding))
        chance = 1 - share + 4 * np.sqrt(share * (1 - share) / n) + 1 / n
        if beyond > chance:
            return (
                f"{beyond:.0%} of {n} episodes differ by more than {MARGIN * quantile:.3g}; "
                f"between processors it is less than {chance:.0%}"
            )
    return None


def _one_sided(signed: np.ndarray, rounding: np.ndarray) -> str | None:
    """Say if more of the differences than chance has are on one side."""
    other = signed[np.abs(signed) > rounding]
    above = int((other > 0).sum())
    if abs(above - other.size / 2) <= ONE_SIDED * np.sqrt(other.size) / 2:
        return None
    return f"{above} of {other.size} episodes that differ are above; between processors half are"


def _every_group(
    table: pl.DataFrame, figure: pl.Expr | None
) -> Iterator[tuple[tuple[str, ...], np.ndarray, bool]]:
    """Yield a group's name, its rows, and whether it is of whole robots, as was measured."""
    yield (), np.arange(table.height), True
    if figure is not None and (rows := _rows_of(table, figure)).size:
        yield ("the headline figure",), rows, False
    for keys in (["ego"], ["partner"], ["ego", "partner"]):
        for group, rows in groups_of(table, keys):
            yield group, rows, keys == ["ego"]


def _rows_of(table: pl.DataFrame, figure: pl.Expr) -> np.ndarray:
    return table.with_row_index("row").filter(figure)["row"].to_numpy()


def groups_of(table: pl.DataFrame, keys: list[str]) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """Yield the values of each group in the key columns, and the numbers of its rows."""
    numbered = table.select(keys).with_row_index("row")
    for group, rows in numbered.group_by(keys, maintain_order=True):
        yield tuple(map(str, group)), rows["row"].to_numpy()


def _named(group: tuple[str, ...]) -> str:
    return " with ".join(group) or "all"


def signed_gaps(first: pl.DataFrame, second: pl.DataFrame, name: str) -> np.ndarray:
    """Return a column of one table minus that of another, row by row."""
    return (first[name].cast(pl.Float64) - second[name].cast(pl.Float64)).to_numpy()
