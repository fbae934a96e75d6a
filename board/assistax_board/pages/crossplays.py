"""Finished cross-plays: the matrix of the explorer, and the facts of each pair."""

import dataclasses
import functools
import hashlib
import json
import threading
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_board.pages.cache import Page, pack
from evaluation.record import tables

PUBLISHED = Path(__file__).parents[3] / "docs" / "data" / "paper" / "crossplay"  # in a checkout


@dataclasses.dataclass(frozen=True, eq=False)
class CrossPlay:
    """One task's matrix of robots by humans."""

    task: str
    facts: dict[str, Any]  # its summary: backend, episodes, figures
    pairs: pl.DataFrame  # one row a pair
    data: dict[str, Any]  # what the explorer draws, but for the values
    values: dict[str, np.ndarray]  # measure -> [robots, humans]
    strategies: dict[str, Any] | None  # clusters of humans by behaviour
    digest: str  # of all that is drawn

    @functools.cached_property
    def description(self) -> Page:
        """Axes, orders and colours as JSON."""
        return pack(json.dumps(self.data, allow_nan=False).encode(), "application/json")

    @functools.cached_property
    def measures(self) -> dict[str, Page]:
        """Values of each measure as little-endian 32-bit floats, robot by robot."""
        return {
            name: pack(np.ascontiguousarray(values, "<f4").tobytes(), "application/octet-stream")
            for name, values in self.values.items()
        }

    @functools.cached_property
    def _places(self) -> dict[tuple[str, str], int]:
        teams = self.pairs.select("ego_team", "partner_team").iter_rows()
        return {pair: i for i, pair in enumerate(teams)}

    def pair(self, robot: str, human: str) -> dict[str, Any] | None:
        """Return the row of a pair, by the ids of the robot's and the human's team."""
        place = self._places.get((robot, human))
        return None if place is None else self.pairs.row(place, named=True)

    @functools.cached_property
    def humans(self) -> dict[str, dict[str, Any]]:
        """Behaviour cluster and features of each human with its best robot, by team."""
        strategies = self.strategies or {"partners": []}
        return {row["partner"].rpartition("/")[0]: row for row in strategies["partners"]}

    @functools.cached_property
    def best_returns(self) -> dict[str, float]:
        """The highest mean return with each human, by the id of its policy."""
        best = self.values["return"].max(axis=0)
        return {
            column["name"]: float(value)
            for column, value in zip(self.data["columns"], best, strict=True)
        }

    def blocks(self, trait: str) -> tuple[list[str], list[str], list[list[float]]]:
        """Mean return by a trait of robot and human: its values, and the means [robots][humans]."""
        rows, columns = (
            np.array([policy[trait] or "–" for policy in self.data[side]])
            for side in ("rows", "columns")
        )
        row_names, column_names = sorted(set(rows.tolist())), sorted(set(columns.tolist()))
        returns = self.values["return"]
        means = [
            [
                float(returns[np.ix_(rows == row, columns == column)].mean())
                for column in column_names
            ]
            for row in row_names
        ]
        return row_names, column_names, means


class CrossPlays:
    """The finished cross-plays of a folder: one subfolder a task, as `crossplay --out` fills it."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = PUBLISHED if folder is None else folder
        self._read: dict[str, CrossPlay] = {}
        self._lock = threading.Lock()

    @functools.cached_property
    def tasks(self) -> tuple[str, ...]:
        """Tasks that somebody has played. No other name is ever joined to a path."""
        return tuple(
            sorted(file.parent.name for file in self._folder.glob(f"*/{tables.PAIRS_FILE}"))
        )

    def of(self, task: str) -> CrossPlay | None:
        """Return a task's cross-play, read when the first reader asks; None if there is none."""
        with self._lock:
            if task not in self._read and task in self.tasks:
                self._read[task] = read_crossplay(task, self._folder / task)
            return self._read.get(task)


def read_crossplay(task: str, folder: Path) -> CrossPlay:
    """Read a folder that `crossplay --out` filled."""
    from evaluation.report.matrix_data import matrix_data  # matplotlib, for its colours

    pairs = tables.read_parquet(folder / tables.PAIRS_FILE)
    path = folder / tables.STRATEGIES_FILE
    strategies = tables.read_json(path) if path.is_file() else None
    data = matrix_data(pairs, strategies)
    shape = len(data["rows"]), len(data["columns"])
    values = {}
    for name, measure in data["measures"].items():
        values[name] = pairs[name].cast(pl.Float32).to_numpy().reshape(shape)
        del measure["values"]  # they follow as bytes
    digest = hashlib.sha256(json.dumps(data).encode())
    for value in values.values():
        digest.update(value.tobytes())
    facts = tables.read_json(folder / tables.SUMMARY_FILE)
    return CrossPlay(task, facts, pairs, data, values, strategies, digest.hexdigest()[:16])
