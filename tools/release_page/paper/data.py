"""Data of the page: registry entries, committed tables, the paper's figures, and notes."""

import dataclasses
import functools
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_envs.versions import PAPER_TASKS
from evaluation.record import tables
from tools.release_page.data import (
    EGOS,
    TRAINING_FILE,
    CrossPlayed,
    check_release,
    read_crossplays,
    read_humans,
    read_pairs,
)
from zoo.registry import Registry
from zoo.schema import PolicyEntry

METHODS = ("ppo", "sac")  # of the egos
CURVES = "curves"  # folder of the learning curves
NOTES_FILE = "notes.md"
NOTES = (
    "summary",
    "population",
    "self-play",
    "curves",
    "cross-play",
    "zsc",
    "claims",
    "made",
)  # sections with a place
_CURVE_COLUMNS = {
    **dict.fromkeys(("task", "algorithm", "disability"), pl.String),
    **{"seed": pl.Int64, "steps": pl.Int64, "return": pl.Float64},
}


@dataclasses.dataclass(frozen=True)
class Egos:
    """Condensed evaluation of one method's egos on a task."""

    pairs: pl.DataFrame
    summary: Mapping[str, Any]
    run: Mapping[str, Any]
    training: Mapping[str, Any] | None  # None if no record of it was collected

    @functools.cached_property
    def partners(self) -> pl.DataFrame:
        """Partner and side, in the order of the columns of `scores`."""
        return self.pairs.select("partner", "side").unique().sort("partner")

    @functools.cached_property
    def scores(self) -> np.ndarray:
        """Mean returns [S, P], a row a seed."""
        wide = self.pairs.sort("ego_seed").pivot("partner", index="ego_seed", values="return")
        return wide.select(self.partners["partner"].to_list()).to_numpy().astype(float)


@dataclasses.dataclass(frozen=True, eq=False)  # claims are kept for each
class Results:
    """All data of the page; absent results are not measured yet."""

    release: str
    humans: list[PolicyEntry]  # one for each team of the release
    curves: pl.DataFrame | None
    crossplay: Mapping[str, CrossPlayed]  # by task
    egos: Mapping[tuple[str, str], Egos]  # by task and method
    paper: Mapping[str, Any]
    notes: Mapping[str, str]  # hand-written Markdown by section

    def self_play(self, task: str, algorithm: str, disability: str = "d1") -> np.ndarray:
        """Return the mean self-play returns [S] of a setting's teams, in order of seeds."""
        humans = [
            human for human in self.humans if (human.task, human.algorithm) == (task, algorithm)
        ]
        humans = sorted(
            (human.seed, human)
            for human in humans
            if human.disability == disability and human.self_play
        )
        return np.array([human.self_play.mean for _, human in humans if human.self_play])

    @property
    def has_curves(self) -> bool:
        """Whether there is a curve of the unimpaired setting, which is the one drawn."""
        return self.curves is not None and not self.curves.filter(disability="d1").is_empty()

    @property
    def missing(self) -> list[str]:
        """Names of the results that are not measured yet."""
        planned_teams = sum(planned(kinds) for kinds in self.paper["population"].values())
        lacks = (
            []
            if len(self.humans) >= planned_teams
            else [f"{planned_teams - len(self.humans)} of {planned_teams} teams of Table 6"]
        )
        unimpaired = None if self.curves is None else self.curves.filter(disability="d1")
        drawn = (
            set()
            if unimpaired is None
            else set(unimpaired.select("task", "algorithm").unique().rows())
        )
        kinds = [
            (task, algorithm)
            for task in PAPER_TASKS
            for algorithm in self.paper["population"][task]
        ]
        lacks += [
            f"learning curves of {name} on {task}"
            for task, name in kinds
            if (task, name) not in drawn
        ]
        lacks += [
            f"cross-play of {self._unplayed(task)}" for task in PAPER_TASKS if self._unplayed(task)
        ]
        pairs = [(task, method) for task in PAPER_TASKS for method in METHODS]
        return [
            *lacks,
            *(
                f"{method} egos on {task}"
                for task, method in pairs
                if (task, method) not in self.egos
            ),
        ]

    def _unplayed(self, task: str) -> str:
        """Return the missing part of a task's cross-play; "" if it holds every team."""
        if task not in self.crossplay:
            return task
        teams = {human.team for human in self.humans if human.task == task}
        absent = teams - set(self.crossplay[task].teams)
        return f"{task} for {len(absent)} of its {len(teams)} teams" if absent else ""


def planned(kinds: Mapping[str, Mapping[str, int]]) -> int:
    """Return the number of the paper's teams of these algorithms of a task."""
    return sum(kind["settings"] * kind["seeds"] for kind in kinds.values())


def read_results(registry: Registry, release: str, data: Path) -> Results:
    """Return the existing results of a release.

    Raises:
        ValueError: a table is malformed, or is of another release.
    """
    humans = read_humans(registry, release, PAPER_TASKS)
    crossplay = read_crossplays(data, PAPER_TASKS)
    folders = {
        (task, name): data / EGOS / f"{task}-{name}" for task in PAPER_TASKS for name in METHODS
    }
    egos = {
        key: _read_egos(folder)
        for key, folder in folders.items()
        if (folder / tables.PAIRS_FILE).is_file()
    }
    for played in (*crossplay.values(), *egos.values()):
        check_release(played, release, {human.team for human in humans}, data)
    return Results(
        release,
        humans,
        _read_curves(data / CURVES),
        crossplay,
        egos,
        read_paper(),
        read_notes(data / NOTES_FILE),
    )


def read_paper() -> dict[str, Any]:
    """Return the paper's figures."""
    return json.loads(Path(__file__).with_name("paper.json").read_text(encoding="utf-8"))


def read_notes(path: Path) -> dict[str, str]:
    """Return the hand-written notes by section, from headings `## SECTION` in Markdown."""
    if not path.is_file():
        return {}
    parts = re.split(r"^## +(.+?) *$", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    sections = dict(zip(parts[1::2], (text.strip() for text in parts[2::2]), strict=True))
    if unknown := [name for name in sections if name not in NOTES]:
        raise ValueError(f"{path} has a section {unknown[0]!r}; allowed are {', '.join(NOTES)}")
    return {name: text for name, text in sections.items() if text}


def _read_egos(folder: Path) -> Egos:
    """Return the condensed evaluation of a folder."""
    training = folder / TRAINING_FILE
    return Egos(
        read_pairs(folder),
        tables.read_json(folder / tables.SUMMARY_FILE),
        tables.read_json(folder / tables.RUN_FILE),
        tables.read_json(training) if training.is_file() else None,
    )


def _read_curves(folder: Path) -> pl.DataFrame | None:
    """Return the learning curves of a folder in one table; None if it has no curves."""
    files = sorted(folder.glob("*.parquet"))
    tables_read = [tables.read_parquet(path) for path in files]
    for path, table in zip(files, tables_read, strict=True):
        if lacking := [name for name in _CURVE_COLUMNS if name not in table.columns]:
            raise ValueError(
                f"{path} lacks {', '.join(lacking)}; a curve has {', '.join(_CURVE_COLUMNS)}"
            )
    return (
        pl.concat(
            [
                table.select(pl.col(name).cast(kind) for name, kind in _CURVE_COLUMNS.items())
                for table in tables_read
            ]
        )
        if tables_read
        else None
    )
