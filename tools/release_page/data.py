"""Data of every release's page: cross-plays and their checks."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import polars as pl
import polars.selectors as cs

from evaluation.record import tables
from zoo.registry import Registry
from zoo.schema import PolicyEntry

CROSSPLAY, EGOS = "crossplay", "egos"  # folders of the data
TRAINING_FILE = "training.json"


class Played(Protocol):
    """Protocol of played results: pairs, summary and run."""

    @property
    def pairs(self) -> pl.DataFrame: ...
    @property
    def summary(self) -> Mapping[str, Any]: ...
    @property
    def run(self) -> Mapping[str, Any]: ...


@dataclasses.dataclass(frozen=True)
class CrossPlayed:
    """Condensed cross-play of a task."""

    pairs: pl.DataFrame
    order: Mapping[str, Any]
    strategies: Mapping[str, Any]
    summary: Mapping[str, Any]
    run: Mapping[str, Any]

    @functools.cached_property
    def matrix(self) -> np.ndarray:
        """Mean returns [T, T], the teams of `teams` on both axes."""
        wide = self.pairs.pivot("partner_team", index="ego_team", values="return")
        rows = pl.DataFrame({"ego_team": self.teams}).join(
            wide, on="ego_team", how="left", maintain_order="left"
        )
        return rows.select(self.teams).to_numpy().astype(float)

    @property
    def teams(self) -> list[str]:
        """Teams in the order of the figure."""
        return self.order["teams"]["order"]

    @property
    def clusters(self) -> list[list[int]]:
        """Members of each cluster, as rows of `matrix`."""
        places = {team: place for place, team in enumerate(self.teams)}
        return [
            [places[team] for team in cluster["members"]]
            for cluster in self.order["teams"]["clusters"]
        ]


def read_humans(registry: Registry, release: str, tasks: Sequence[str]) -> list[PolicyEntry]:
    """Return the humans of a release on some tasks, one for each team."""
    return [
        entry
        for entry in registry.policies
        if entry.role == "human" and entry.release == release and entry.task in tasks
    ]


def read_crossplays(data: Path, tasks: Sequence[str]) -> dict[str, CrossPlayed]:
    """Return the existing condensed cross-plays, by task."""
    folders = {task: data / CROSSPLAY / task for task in tasks}
    return {task: read_crossplay(folder) for task, folder in folders.items() if folder.is_dir()}


def check_release(table: Played, release: str, teams: set[str], data: Path) -> None:
    """Refuse a table of another release, or with partners that are not among the teams."""
    summary = table.summary
    if summary["release"] != release:
        raise ValueError(
            f"{data} holds {summary['task']} of release {summary['release']}, and the page is of "
            f"{release}; give the data of {release}"
        )
    others = sorted(set(table.pairs["partner_team"]) - teams)
    if others:
        raise ValueError(
            f"{data} has {len(others)} partners on {summary['task']} that are not in release "
            f"{release}, first {others[0]}; play the teams of one release, such as --partners "
            f"'{summary['task']}/*-{release}'"
        )


def read_crossplay(folder: Path) -> CrossPlayed:
    """Return a condensed cross-play, whose axes have the same teams."""
    order, strategies, summary, run = (
        tables.read_json(folder / name)
        for name in (
            tables.ORDER_FILE,
            tables.STRATEGIES_FILE,
            tables.SUMMARY_FILE,
            tables.RUN_FILE,
        )
    )
    if order["teams"] is None:
        raise ValueError(
            f"{folder} has other teams on its rows than on its columns; collect a whole cross-play"
        )
    return CrossPlayed(read_pairs(folder), order, strategies, summary, run)


def read_pairs(folder: Path) -> pl.DataFrame:
    """Return a folder's table of pairs, with floats of 64 bits."""
    return tables.read_parquet(folder / tables.PAIRS_FILE).with_columns(cs.float().cast(pl.Float64))
