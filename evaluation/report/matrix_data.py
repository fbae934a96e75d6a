"""Data of the page's interactive matrix: saved pairs, their orders, and colours, as JSON."""

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
import polars as pl
from matplotlib.colors import to_hex

from evaluation.figures.clustering import clustered_order
from evaluation.plots import style
from evaluation.plots.crossplay.matrix import short_names
from evaluation.plots.crossplay.traits import traits_of

MEASURES = {  # column of the pairs -> label, unit
    "return": ("mean return", ""),
    "success": ("success", "of episodes"),
    "force_mean": ("mean force", "N"),
    "force_peak": ("peak force", "N"),
    "first_contact": ("first contact after", "steps"),
    "distance_mean": ("mean distance", "m"),
    "robot_travel": ("joint travel, robot", "rad"),
    "human_travel": ("joint travel, human", "rad"),
}
_DIGITS = 4  # significant, of what is only looked at

Places = tuple[list[int], list[int]]  # an order along an axis, and where lines are drawn


def matrix_data(pairs: pl.DataFrame, strategies: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return axes, measures as [robots][humans] in the table's order, orders and palettes."""
    rows, columns = (_axis(pairs, seat) for seat in ("ego", "partner"))
    both = [*rows, *columns]
    traits = traits_of(*([one[name] for one in both] for name in ("algorithm", "disability")))
    for one in both:
        policy = one["algorithm"], one["disability"]
        one["traits"] = {trait.name: trait.value(*policy) for trait in traits}
    shape = len(rows), len(columns)
    measures = {
        name: {
            "label": label,
            "unit": unit,
            "values": _rounded(pairs[name].cast(pl.Float64).to_numpy().reshape(shape)),
        }
        for name, (label, unit) in MEASURES.items()
        if name in pairs.columns
    }
    return {
        "rows": rows,
        "columns": columns,
        "measures": measures,
        "orders": _orders(
            rows,
            columns,
            pairs["return"].to_numpy().reshape(shape),
            clustered_order(pairs),
            strategies,
        ),
        "colours": [
            to_hex(colour)
            for colour in matplotlib.colormaps[style.COLOUR_MAP](np.linspace(0, 1, 256))
        ],
        "strips": [trait.name for trait in traits],  # from the matrix outwards
        "palettes": {trait.name: trait.colours for trait in traits},
    }


def _axis(pairs: pl.DataFrame, seat: str) -> list[dict[str, Any]]:
    traits = ("team", "algorithm", "disability")
    policies = pairs.select(seat, *(f"{seat}_{trait}" for trait in traits)).unique(
        seat, maintain_order=True
    )
    shorts = short_names(policies[seat].to_list())
    return [
        {"name": row[seat], "short": short, **{trait: row[f"{seat}_{trait}"] for trait in traits}}
        for row, short in zip(policies.iter_rows(named=True), shorts, strict=True)
    ]


def _orders(
    rows: list[dict[str, Any]],
    columns: list[dict[str, Any]],
    returns: np.ndarray,
    order: Mapping[str, Any],
    strategies: Mapping[str, Any] | None,
) -> dict[str, dict[str, Any]]:
    orders: dict[str, dict[str, Any]] = {}

    def add(name: str, label: str, row: Places, column: Places) -> None:
        axes = {"rows": row[0], "rowBreaks": row[1]}
        orders[name] = {"label": label, **axes, "columns": column[0], "columnBreaks": column[1]}

    if order["teams"]:
        label = "clustered, one order of teams"
        teams = (_clustered(axis, "team", order["teams"]) for axis in (rows, columns))
        add("teams", label, *teams)
    by_row = _clustered(rows, "name", order["rows"])
    by_column = _clustered(columns, "name", order["columns"])
    add("separate", "clustered, each axis by itself", by_row, by_column)
    if strategies:
        members = [name for cluster in strategies["clusters"] for name in cluster["members"]]
        grouped = {"order": members, "clusters": strategies["clusters"]}
        add("strategies", "humans by behaviour", by_row, _clustered(columns, "name", grouped))
    for first, second in (("algorithm", "disability"), ("disability", "algorithm")):
        sorted_axes = (_by_traits(axis, (first, second)) for axis in (rows, columns))
        add(first, f"{first}, then {second}", *sorted_axes)
    best = (np.argsort(-returns.mean(axis=axis), kind="stable").tolist() for axis in (1, 0))
    orders["mean"] = {"label": "mean return", **dict(zip(("rows", "columns"), best, strict=True))}
    return orders


def _clustered(policies: list[dict[str, Any]], key: str, order: Mapping[str, Any]) -> Places:
    place = {policy[key]: i for i, policy in enumerate(policies)}
    sizes = [len(cluster["members"]) for cluster in order["clusters"]]
    return [place[name] for name in order["order"]], np.cumsum(sizes)[:-1].tolist()


def _by_traits(policies: list[dict[str, Any]], traits: tuple[str, str]) -> Places:
    """Return the order by two traits, and a line at each change of the first; unknown is last."""

    def known(i: int) -> list[tuple[bool, str]]:
        return [(policies[i][trait] is None, policies[i][trait] or "") for trait in traits]

    order = sorted(range(len(policies)), key=known)
    first = [policies[i][traits[0]] for i in order]
    return order, [i for i in range(1, len(first)) if first[i] != first[i - 1]]


def _rounded(values: np.ndarray) -> list[list[float]]:
    return [[float(f"{value:.{_DIGITS}g}") for value in row] for row in values]
