"""A folder of logs as results: episodes by robot, ranks beside persons, and behaviour."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.errors import listing
from evaluation.figures.summary import EvaluationSummary
from evaluation.people.behaviour import (
    Distribution,
    behaviour,
    distributions,
    persons_behaviour,
)
from evaluation.people.beside import Beside, beside, read_beside
from evaluation.people.folders import episode_table, save_people
from evaluation.people.grouping import Placed, find_logs, grouped, persons_of
from evaluation.people.log import LogError
from evaluation.people.replaying import Refused, Replayed, replay_logs
from evaluation.record import tables
from zoo.registry import Registry

OUTCOMES_FILE = "people.json"  # what became of each log


@dataclasses.dataclass(frozen=True)
class TaskFigures:
    """Figures of the episodes of a task."""

    task: str
    robots: dict[str, EvaluationSummary]  # by result folder
    people: int
    episodes: int
    # Distributions of `behaviour.NAMES` with people, and with persons if some were played.
    behaviour: dict[str, Distribution]
    persons: dict[str, Distribution]
    beside: tuple[Beside, ...] = ()  # empty if no result of persons was given


@dataclasses.dataclass(frozen=True)
class People:
    """What a folder of logs holds."""

    folder: str
    logs: int
    accepted: dict[str, str]  # file -> its partner, robot and number among the episodes
    left_out: dict[str, str]  # file -> why it is no episode of the tables, though it is true
    refused: dict[str, str]  # file -> why it is no true log
    tasks: tuple[TaskFigures, ...]


def read_people(
    folder: Path,
    out: Path,
    registry: Registry,
    *,
    beside_results: Sequence[Path] = (),
    episodes: int | None = None,
    persons: int = 0,
    check: Callable[[], None] = lambda: None,
    also: Callable[[Path, Sequence[Placed]], Any] | None = None,
) -> People:
    """Play all logs of a folder again, and write a result folder for each task and robot.

    Every file is listed in `people.json` below `out`: accepted, left out, or refused with a reason.

    Args:
        folder: The logs; a subfolder holds those of one person.
        out: Folder of the result folders, `out`/TASK/ROBOT.
        registry: The registry of the robots.
        beside_results: Result folders of the same robots with persons.
        episodes: Episodes of each partner with each robot; see `grouping.grouped`.
        persons: Persons of each family whose behaviour is measured beside the people's, with each
            robot; 0 for none.
        check: Called now and then; it may raise to stop.
        also: See `folders.save_people`.

    Raises:
        ValueError: There is no log that fits its episode, or an argument is not allowed.
    """
    paths, persons_played = find_logs(folder), read_beside(beside_results)
    outcomes: list[Replayed | Refused] = replay_logs(paths, registry, check)
    true = [outcome for outcome in outcomes if isinstance(outcome, Replayed)]
    refused = [outcome for outcome in outcomes if isinstance(outcome, Refused)]
    if not true:
        reasons = (f"{one.path.name}: {one.why}" for one in refused)
        raise LogError(f"no log of {folder} fits its episode; {listing(reasons, 3)}")
    groups = grouped(folder, true, episodes)
    summaries = save_people(out, groups.placed, registry, also)
    tasks = []
    for task in sorted({one.replayed.recorded.log.task for one in groups.placed}):
        check()
        mine = [one for one in groups.placed if one.replayed.recorded.log.task == task]
        robots = {str(f): summary for f, summary in summaries.items() if summary.task == task}
        tasks.append(_figures(task, mine, robots, persons_played.get(task), persons))
    people = People(
        folder=str(folder),
        logs=len(paths),
        accepted={
            str(one.replayed.recorded.path): f"{one.partner} with {one.replayed.robot.name}, "
            f"episode {one.episode}"
            for one in groups.placed
        },
        left_out={str(one.path): one.why for one in groups.left_out},
        refused={str(one.path): one.why for one in refused},
        tasks=tuple(tasks),
    )
    listed = {name: getattr(people, name) for name in ("accepted", "left_out", "refused")}
    tables.write_json({"folder": people.folder, **listed}, out / OUTCOMES_FILE)
    return people


def _figures(
    task: str,
    placed: Sequence[Placed],
    robots: dict[str, EvaluationSummary],
    played: pl.DataFrame | None,
    persons: int,
) -> TaskFigures:
    """Return the figures of a task."""
    rows = [behaviour(task, one.replayed.steps, one.replayed.recorded.words) for one in placed]
    met = {one.replayed.robot.name: one.replayed.robot for one in placed}
    beside_them = [
        row for robot in met.values() for row in persons_behaviour(task, robot, persons)
    ] if persons else []  # fmt: skip
    ranked = () if played is None else beside(episode_table(placed), played)
    return TaskFigures(
        task=task,
        robots=robots,
        people=len([*persons_of(placed)]),
        episodes=len(placed),
        behaviour=distributions(rows),
        persons=distributions(beside_them) if persons else {},
        beside=ranked,
    )
