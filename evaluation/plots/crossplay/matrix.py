"""A saved cross-play matrix in the order in which it is drawn."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import polars as pl

from assistax_envs.versions import TASKS
from evaluation.figures.clustering import clustered_order

Order = Literal["shared", "separate"]
ORDERS: tuple[Order, ...] = ("shared", "separate")
_LONGEST = 26  # characters of a name


@dataclasses.dataclass(frozen=True)
class Cluster:
    """A run of neighbours along one axis."""

    letter: str
    start: int  # first position
    stop: int  # one past the last
    medoid: str  # short name


@dataclasses.dataclass(frozen=True)
class Side:
    """The policies, traits and clusters along one axis, in drawing order."""

    names: tuple[str, ...]  # short
    teams: tuple[str | None, ...]
    algorithms: tuple[str | None, ...]
    disabilities: tuple[str | None, ...]
    clusters: tuple[Cluster, ...]
    silhouette: float | None
    linkage: np.ndarray  # [n - 1, 4]

    def __len__(self) -> int:
        return len(self.names)


@dataclasses.dataclass(frozen=True)
class Matrix:
    """Mean returns of robots (rows) with humans (columns)."""

    values: np.ndarray  # [R, C]
    rows: Side
    columns: Side
    shared: bool  # rows and columns in one order of teams

    @property
    def self_play(self) -> np.ndarray:
        """Mask [R, C] of the robots with the human of their own team."""
        return np.array(
            [
                [row is not None and row == column for column in self.columns.teams]
                for row in self.rows.teams
            ]
        )


def arrange(pairs: pl.DataFrame, how: Order | None = None) -> Matrix:
    """Return the matrix of saved pairs in its clustered order.

    Args:
        pairs: The table of pairs that `crossplay` saved.
        how: "shared" for one order of teams on both axes; None chooses it if both axes have the
            same teams.

    Raises:
        ValueError: There is no shared order, or the table lacks a pair.
    """
    if how is not None and how not in ORDERS:
        raise ValueError(f"order is {how!r}; allowed are {', '.join(ORDERS)}")
    order = clustered_order(pairs)
    if how == "shared" and order["teams"] is None:
        raise ValueError(
            "rows and columns are not the same teams, so they share no order; choose 'separate'"
        )
    shared = order["teams"] is not None and how != "separate"
    orders = [order["teams"]] * 2 if shared else [order["rows"], order["columns"]]
    rows, columns = (
        _policies(pairs, seat, part, shared)
        for seat, part in zip(("ego", "partner"), orders, strict=True)
    )
    wide = pairs.pivot("partner", index="ego", values="return")
    return Matrix(
        rows.select("ego")
        .join(wide, on="ego", how="left", maintain_order="left")
        .select(pl.col(columns["partner"].to_list()).cast(pl.Float64))
        .to_numpy(),
        _side(rows, "ego", orders[0], "A"),
        _side(columns, "partner", orders[1], "A" if shared else "a"),
        shared,
    )


def short_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return ids without their common parts: task, role, and the release if it is the same.

    The namespace of another zoo's policies stays.
    """
    parts = [name.split("/") for name in names]
    short = [
        _namespace(part[0]) + part[1] if len(part) in (2, 3) else name
        for name, part in zip(names, parts, strict=True)
    ]
    endings = {name.rpartition("-")[2] for name in short}
    if len(endings) == 1 and len(short) > 1 and endings.pop().startswith("v"):
        short = [name.rpartition("-")[0] for name in short]
    if len(set(short)) < len(set(names)):
        short = list(names)
    return tuple(name if len(name) <= _LONGEST else f"...{name[3 - _LONGEST :]}" for name in short)


def _namespace(text: str) -> str:
    """Return "lab:" of "lab:scratch"; empty if the text before a colon is not a namespace."""
    namespace, colon, task = text.rpartition(":")
    return namespace + colon if task in TASKS else ""


def _policies(
    pairs: pl.DataFrame, seat: str, order: Mapping[str, Any], shared: bool
) -> pl.DataFrame:
    identity = f"{seat}_team" if shared else seat
    described = pairs.select(pl.col(f"^{seat}(_.*)?$")).unique(identity, maintain_order=True)
    names = pl.DataFrame({identity: order["order"]}, schema={identity: pl.String})
    return names.join(described, on=identity, how="left", maintain_order="left")


def _side(policies: pl.DataFrame, seat: str, order: Mapping[str, Any], first: str) -> Side:
    names = short_names(order["order"])
    short = dict(zip(order["order"], names, strict=True))
    clusters, start = [], 0
    for i, cluster in enumerate(order["clusters"]):
        stop = start + len(cluster["members"])
        clusters.append(Cluster(chr(ord(first) + i), start, stop, short[cluster["medoid"]]))
        start = stop
    team, algorithm, disability = (
        policies[f"{seat}_{trait}"] for trait in ("team", "algorithm", "disability")
    )
    return Side(
        names=names,
        teams=tuple(team),
        algorithms=tuple(algorithm),
        disabilities=tuple(disability),
        clusters=tuple(clusters),
        silhouette=order["silhouette"],
        linkage=np.asarray(order["linkage"], float).reshape(-1, 4),
    )
