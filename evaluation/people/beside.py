"""Ranks of robots by their returns with people, beside those with persons."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from assistax_envs.versions import VERSIONS
from evaluation.figures.metrics import Agreement, rank_agreement
from evaluation.figures.normalised import COLUMN, SCRIPT
from evaluation.figures.summary import read_summary
from evaluation.people.grouping import PEOPLE
from evaluation.record import tables
from evaluation.record.columns import measures_care
from evaluation.record.record import Record
from evaluation.record.verification import strange_tables_refused

# What robots are ranked by: columns of the episode table, and whether more is better.
RANKED = {"return": True, "success": True, "discomfort_share": False}


@dataclasses.dataclass(frozen=True)
class Beside:
    """Robots of a task by one column, with people and with persons."""

    column: str
    robots: tuple[str, ...]  # those that both met, best with people first
    people: tuple[float, ...]  # mean of each with people
    persons: tuple[float, ...]
    agreement: Agreement | None  # None with fewer than two robots, or if all tie


def read_beside(folders: Sequence[Path]) -> dict[str, pl.DataFrame]:
    """Return the episodes of persons in finished folders by task: ego, partner, ranked columns.

    The script that played as a reference is a robot too.

    Raises:
        ValueError: A folder is of another version of its task, of people, or is damaged.
    """
    parts: dict[str, list[pl.DataFrame]] = {}
    for folder in folders:
        with strange_tables_refused(folder):
            summary, table = read_summary(folder), Record.read(folder).table
            if summary.env_version != VERSIONS.get(summary.task):
                raise ValueError(
                    f"{folder} is of {summary.task}, version {summary.env_version}; evaluate anew, "
                    "in the version of today, in which logs are played"
                )
            if not measures_care(table) or PEOPLE in set(table["partner_algorithm"]):
                raise ValueError(f"{folder} is not of persons of a gentle task; give such a result")
            mine = parts.setdefault(summary.task, [])
            mine.append(table.select("ego", "partner", *RANKED))
            path = folder / tables.REFERENCES_FILE
            if path.is_file():
                script = tables.read_parquet(path).filter(pl.col(COLUMN) == SCRIPT)
                mine.append(script.select("ego", "partner", *RANKED))
    return {task: pl.concat(part) for task, part in parts.items()}


def beside(people: pl.DataFrame, persons: pl.DataFrame, *, seed: int = 0) -> tuple[Beside, ...]:
    """Return the robots that both met, ranked by each column of `RANKED`.

    Args:
        people: Episodes of people of one task, with the columns `ego`, `partner` and `RANKED`.
        persons: Episodes of persons, likewise.
        seed: Seed of the resamples.

    Raises:
        ValueError: No robot met both.
    """
    robots = sorted(set(people["ego"]) & set(persons["ego"]))
    if not robots:
        raise ValueError(
            f"people met {', '.join(sorted(set(people['ego'])))}, and persons met others; evaluate "
            "the same robots with persons"
        )
    return tuple(_ranked(column, robots, people, persons, seed) for column in RANKED)


def _ranked(
    column: str, robots: Sequence[str], people: pl.DataFrame, persons: pl.DataFrame, seed: int
) -> Beside:
    """Return the robots ranked by one column."""
    sign = 1.0 if RANKED[column] else -1.0
    scores = [sign * _scores(table, robots, column) for table in (people, persons)]
    means = [sign * np.nanmean(score, axis=1) for score in scores]
    order = np.argsort(-sign * means[0], kind="stable")
    return Beside(
        column,
        tuple(robots[place] for place in order),
        *(tuple(float(mean[place]) for place in order) for mean in means),
        agreement=rank_agreement(*(score[order] for score in scores), seed=seed),
    )


def _scores(table: pl.DataFrame, robots: Sequence[str], column: str) -> np.ndarray:
    """Return the means of pairs over episodes, [R, P]; NaN where they did not meet."""
    means = table.group_by("ego", "partner").agg(pl.col(column).cast(pl.Float64).mean())
    found: Mapping[tuple[str, str], float] = {(e, p): v for e, p, v in means.iter_rows()}
    partners = sorted({partner for ego, partner in found if ego in robots})
    return np.array([[found.get((robot, p), np.nan) for p in partners] for robot in robots])
