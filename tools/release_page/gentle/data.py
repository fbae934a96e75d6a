"""What the page is made from: registry entries and committed tables."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from assistax_envs.versions import GENTLE_TASKS, PAPER_TASKS
from evaluation.record import tables
from evaluation.record.columns import SIDES
from tools.release_page.data import (
    EGOS,
    TRAINING_FILE,
    CrossPlayed,
    check_release,
    read_crossplays,
    read_humans,
    read_pairs,
)
from tools.release_page.gentle.evaluations import KEY, MEASURES, SERIES, checked_name
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split

MIRROR = "-mirror"  # ends the name of a method that was trained with the test side
WANTED = ("ppo", "sac", f"ppo{MIRROR}", f"ppo{SERIES}", f"ppo-gru{SERIES}")  # on a default split


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """The condensed evaluation of one method's robots on a split of a task."""

    pairs: pl.DataFrame
    summary: Mapping[str, Any]
    run: Mapping[str, Any]

    def scores(self, measure: str, side: str, place: int | None = None) -> np.ndarray:
        """Return a measure's means over episodes, [S, P]: seeds, and partners of a side by id.

        Of a series, `place` is the one that is meant; without it, all of them.

        Raises:
            ValueError: A pair was not played, or a value is not finite.
        """
        chosen = self.pairs.filter(pl.col("side") == side)
        chosen = chosen if place is None else chosen.filter(pl.col("place") == place)
        total = (pl.col(measure) * pl.col("episodes")).sum() / pl.col("episodes").sum()
        means = chosen.group_by("ego_seed", "partner").agg(total.alias(measure))
        wide = means.pivot("partner", index="ego_seed", values=measure).sort("ego_seed")
        partners = chosen["partner"].unique().sort().to_list()
        values = wide.select(partners).to_numpy().astype(float)
        if not np.isfinite(values).all():
            raise ValueError(
                f"{measure} of {np.count_nonzero(~np.isfinite(values))} of {values.size} pairs on "
                f"{self.summary['task']} is not there; collect the whole evaluation again"
            )
        return values

    @property
    def seeds(self) -> int:
        """Number of the robots."""
        return self.pairs["ego_seed"].n_unique()

    @property
    def places(self) -> list[int]:
        """Places of a series, from 1; none where no series was played."""
        return self.pairs["place"].unique().sort().to_list() if "place" in self.pairs else []

    def played(self, side: str) -> pl.DataFrame:
        """Return what every robot played on a side: episodes by partner and preference."""
        return (
            self.pairs.filter(pl.col("side") == side)
            .group_by(KEY[1:])
            .agg(pl.col("episodes").sum() / pl.col("ego_seed").n_unique())
            .sort(KEY[1:])
        )


@dataclasses.dataclass(frozen=True, eq=False)  # figures are kept for each
class Results:
    """Everything that the page shows; what is absent is not measured yet."""

    release: str
    humans: Sequence[PolicyEntry]  # one for each team of the release
    splits: Mapping[str, Sequence[Split]]  # by task, its default split first
    egos: Mapping[tuple[str, str, str], Evaluated]  # by task, name of the split, and method
    trained: Mapping[tuple[str, str, str], Mapping[str, Any]]  # the same keys
    crossplay: Mapping[str, CrossPlayed]  # by task
    paper: Mapping[str, CrossPlayed]  # of release v1, by task

    def methods(
        self, task: str, split: Split, *, series: bool = False, mirrored: bool = False
    ) -> dict[str, Evaluated]:
        """Return what was evaluated on a split, by method; mirrored ones are no methods."""
        return {
            method: egos
            for (its_task, name, method), egos in self.egos.items()
            if (its_task, name) == (task, short(split))
            and method.endswith(SERIES) == series
            and (mirrored or not method.endswith(MIRROR))
        }

    def on_default(self, task: str, *, series: bool = False) -> dict[str, Evaluated]:
        """Return the same of a task's default split; empty where it has none."""
        return {
            method: egos
            for split in self.splits[task][:1]
            for method, egos in self.methods(task, split, series=series).items()
        }

    @property
    def missing(self) -> list[str]:
        """Name what is not measured yet."""
        lacks = []
        for task in GENTLE_TASKS:
            if not any(human.task == task for human in self.humans):
                lacks.append(f"teams of {task}")
            lacks += [] if task in self.crossplay else [f"cross-play of {task}"]
            default = short(self.splits[task][0]) if self.splits[task] else ""
            lacks += [
                f"{method} on {task}"
                for method in WANTED
                if (task, default, method) not in self.egos
            ]
        return lacks


def short(split: Split) -> str:
    """Return a split's name without its task: the name of its folder."""
    return split.id.removeprefix(f"{split.task}/")


def read_results(registry: Registry, release: str, data: Path) -> Results:
    """Read what there is of a release, and the cross-plays of release v1 beside its data.

    Raises:
        ValueError: A table is malformed, of another release, or of other sides of a split.
    """
    humans = read_humans(registry, release, GENTLE_TASKS)
    defaults = registry.data.releases[release].splits if release in registry.data.releases else {}
    splits = {
        task: sorted(
            (split for split in registry.splits if (split.task, split.release) == (task, release)),
            key=lambda split: (split.id != defaults.get(split.task), split.id),
        )
        for task in GENTLE_TASKS
    }
    folders = {
        (task, path.parent.name, path.name): path
        for task in GENTLE_TASKS
        for path in sorted((data / EGOS / task).glob("*/*"))
    }
    for _, split, method in folders:
        checked_name(split, "split")
        checked_name(method, "method")
    egos = {
        key: _read_egos(path)
        for key, path in folders.items()
        if (path / tables.PAIRS_FILE).is_file()
    }
    trained = {
        key: tables.read_json(path / TRAINING_FILE)
        for key, path in folders.items()
        if (path / TRAINING_FILE).is_file()
    }
    crossplay = read_crossplays(data, GENTLE_TASKS)
    for played in (*crossplay.values(), *egos.values()):
        check_release(played, release, {human.team for human in humans}, data)
    for (task, name, method), played in egos.items():
        _check_sides(
            played, {short(split): split for split in splits[task]}.get(name), name, method
        )
    beside = read_crossplays(data.with_name("v1"), PAPER_TASKS)
    return Results(release, humans, splits, egos, trained, crossplay, beside)


def _read_egos(folder: Path) -> Evaluated:
    documents = (tables.read_json(folder / name) for name in (tables.SUMMARY_FILE, tables.RUN_FILE))
    egos = Evaluated(read_pairs(folder), *documents)
    needed = (*KEY, "partner_team", "side", *MEASURES, "episodes", "nonfinite")
    if lacking := [name for name in needed if name not in egos.pairs.columns]:
        raise ValueError(f"{folder} lacks the columns {', '.join(lacking)}; collect it again")
    return egos


def _check_sides(egos: Evaluated, split: Split | None, name: str, method: str) -> None:
    """Refuse an evaluation whose partners are not those of its split's sides, all of them."""
    if split is None:
        raise ValueError(f"{method} was evaluated on {name}, which is not a split of the release")
    for side in SIDES:
        teams = set(egos.pairs.filter(pl.col("side") == side)["partner_team"])
        if teams and teams != set(getattr(split, side)):
            raise ValueError(
                f"{method} was evaluated with other {side} partners than those of {split.id}: "
                f"{len(teams)} of them, and {len(getattr(split, side))} in the split"
            )
