"""Differences of honest episodes between two kinds of processor, and the test of a replay.

Processors with other instructions round differently, and contacts amplify the last bits. Most
episodes end almost the same, a few very differently. `replay_noise.json` holds these differences by
task and column, measured for sixteen published robots with sixteen humans each, with and without
fused multiply-adds (`python -m tools.replay_noise`). They do not depend on the tested folder, so a
forger cannot enlarge them.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from evaluation.figures.normalised import RANDOM
from evaluation.record.columns import METRIC_PREFIX

QUANTILES = (0.5, 0.75, 0.9, 0.97)  # of the absolute differences of a robot's episodes
MARGIN = 2.0  # factor on the measured differences of single episodes, for more variable robots
DEVIATIONS = 6.0  # allowed standard deviations of a mean, large because many groups are tested
# Allowed standard deviations of the number of positive differences. The largest measured one of any
# group and column was 3.6.
ONE_SIDED = 5.0
ROUNDING = 1e-5  # relative rounding of 32-bit sums over a thousand steps
FILE = Path(__file__).with_name("replay_noise.json")


def read_noise(task: str) -> dict[str, dict[str, Any]]:
    """Return the measured `quantiles`, `rms` and `largest` difference of each column of a task.

    Args:
        task: A task, or `wild(task)`.

    Raises:
        ValueError: The task was not measured.
    """
    measured = json.loads(FILE.read_text())
    if task not in measured:
        raise ValueError(
            f"how far episodes of {task} differ between processors was never measured; replay the "
            "folder on the kind of processor that made it"
        )
    return measured[task]


def wild(task: str) -> str:
    """Return the key of a task's random robot in the file of noise; its episodes differ most."""
    return f"{task}/{RANDOM}"


def measured_columns(table: pl.DataFrame) -> list[str]:
    """Return the numeric columns that are results of playing, not fixed by the job."""
    planned = {"episode", "place", "key"}
    return [
        name
        for name, kind in table.schema.items()
        if (kind.is_numeric() or kind == pl.Boolean)
        and not name.endswith("_seed")
        and name not in planned
        and not name.startswith(METRIC_PREFIX)  # of packages: `ReceivedMetrics.noise_notes`
    ]


def differing_rows(kept: pl.DataFrame, played: pl.DataFrame) -> np.ndarray:
    """Return a mask [N] of the episodes with a value that differs between the two tables."""
    same = [kept[name].eq_missing(played[name]).to_numpy() for name in kept.columns]
    return ~np.all(same, axis=0)


def noise_problems(
    task: str, kept: pl.DataFrame, played: pl.DataFrame, *figures: pl.Expr
) -> list[str]:
    """Return problems of groups of episodes that differ by more than processors do.

    For all episodes and for each robot's, the share of differences above each quantile must not
    exceed that of the worst measured robot. For these, and for the episodes of each partner, each
    pair and the headline figure, the mean difference and the number of positive differences must be
    within the limits for so many episodes.

    Args:
        task: The task whose measured differences are used.
        kept: The folder's episodes.
        played: The same episodes in the same order, played here.
        *figures: Filters of the headline figure's episodes, one for each mean of which it is the
            mean. Without them, a forger could raise these and lower others.
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
        for group, rows, of_robots in _every_group(kept, figures):
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

    It assumes that a forger changed all episodes of the figure equally. If none of the figure's
    episodes were replayed, return None.

    Args:
        task: The task whose measured differences are used.
        played: The replayed episodes.
        figure: Filter of the headline figure's episodes.
        name: The column.
    """
    rows = _rows_of(played, figure)
    if not rows.size:
        return None
    return float(_largest_mean(read_noise(task)[name], _rounding(played, name)[rows]))


def _largest_mean(scale: dict[str, Any], rounding: np.ndarray) -> float:
    """Return the largest mean difference that passes for a group with these roundings [N]."""
    return mean_tolerance(scale, rounding.size) + rounding.mean()


def _rounding(played: pl.DataFrame, name: str) -> np.ndarray:
    """Return the difference [N] by rounding that each value of a column may always have."""
    return ROUNDING * (1 + np.abs(played[name].cast(pl.Float64).to_numpy()))


def mean_tolerance(scale: dict[str, Any], episodes: int) -> float:
    """Return the largest difference of a mean over `episodes` between processors."""
    return DEVIATIONS * scale["rms"] / np.sqrt(episodes) + MARGIN * scale["largest"] / episodes


def _beyond(gaps: np.ndarray, rounding: np.ndarray, scale: dict[str, Any]) -> str | None:
    """Return a text if more episodes differ by a quantile than chance allows, else None."""
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
    """Return a text if the differences are mostly positive or mostly negative, else None."""
    differing = signed[np.abs(signed) > rounding]
    above = int((differing > 0).sum())
    if abs(above - differing.size / 2) <= ONE_SIDED * np.sqrt(differing.size) / 2:
        return None
    return (
        f"{above} of {differing.size} episodes that differ are above; between processors half are"
    )


def _every_group(
    table: pl.DataFrame, figures: Sequence[pl.Expr]
) -> Iterator[tuple[tuple[str, ...], np.ndarray, bool]]:
    """Yield each group's name and rows, and whether it has all episodes of its robots.

    Quantiles were measured for groups with all episodes of a robot.
    """
    yield (), np.arange(table.height), True
    for figure in figures:
        if (rows := _rows_of(table, figure)).size:
            yield ("the headline figure",), rows, False
    for keys in (["ego"], ["partner"], ["ego", "partner"]):
        for group, rows in groups_of(table, keys):
            yield group, rows, keys == ["ego"]


def _rows_of(table: pl.DataFrame, figure: pl.Expr) -> np.ndarray:
    return table.with_row_index("row").filter(figure)["row"].to_numpy()


def groups_of(table: pl.DataFrame, keys: list[str]) -> Iterator[tuple[tuple[str, ...], np.ndarray]]:
    """Yield each group's values in the key columns, as texts, and the indices of its rows."""
    numbered = table.select(keys).with_row_index("row")
    for group, rows in numbered.group_by(keys, maintain_order=True):
        yield tuple(map(str, group)), rows["row"].to_numpy()


def _named(group: tuple[str, ...]) -> str:
    return " with ".join(group) or "all"


def signed_gaps(first: pl.DataFrame, second: pl.DataFrame, name: str) -> np.ndarray:
    """Return a column of one table minus that of another, row by row."""
    return (first[name].cast(pl.Float64) - second[name].cast(pl.Float64)).to_numpy()
