"""Logs of people that an organiser accepts: each is played again and noted in the ledger.

The page plays published robots and scripts. So figures with people stand beside rows to measure by,
which are those robots. An acceptance takes the place of an earlier one of the same task: accepted
anew without a person's logs, that person's are withdrawn.
"""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from assistax_board.problems import Problem
from assistax_board.service import Service
from assistax_board.vocabulary import PEOPLE

if TYPE_CHECKING:
    from evaluation.people.grouping import Placed
    from evaluation.people.replaying import Refused
    from zoo.registry import Registry


@dataclasses.dataclass(frozen=True)
class Accepted:
    """Accepted and refused logs of a folder."""

    tasks: tuple[dict[str, Any], ...]  # bodies of the ledger's entries
    refused: tuple["Refused", ...]
    left_out: tuple["Refused", ...]


def accept_people(service: Service, folder: Path, registry: "Registry") -> Accepted:
    """Play the logs of a folder again, and record the figures of those that fit their episodes.

    Args:
        service: The service.
        folder: The logs; a subfolder holds those of one person.
        registry: The registry of the robots.

    Raises:
        Problem: No log is accepted.
        ValueError: There is no log, or a subfolder is no name of a person.
    """
    from evaluation.people.grouping import find_logs, grouped
    from evaluation.people.replaying import Refused, replay_logs

    outcomes = replay_logs(find_logs(folder), registry)
    refused = tuple(one for one in outcomes if isinstance(one, Refused))
    true = [one for one in outcomes if not isinstance(one, Refused)]
    if not true:
        raise Problem("invalid", f"no log of {folder} fits its episode: {refused[0].why}")
    groups = grouped(folder, true)
    tasks = sorted({one.replayed.recorded.log.task for one in groups.placed})
    bodies = tuple(
        _body(task, [one for one in groups.placed if one.replayed.recorded.log.task == task])
        for task in tasks
    )
    with service.begin() as transaction:
        for body in bodies:
            transaction.record(PEOPLE, body)
    return Accepted(bodies, refused, groups.left_out)


def withdraw_people(service: Service, task: str) -> None:
    """Take the figures with people of a task off its board.

    Raises:
        Problem: There are none.
    """
    if not (service.queries.people(task) or {}).get("methods"):
        raise Problem("not_found", f"the board of {task} has no figures with people")
    with service.begin() as transaction:
        transaction.record(PEOPLE, {"task": task, "methods": {}, "logs": []})


def _body(task: str, placed: Sequence["Placed"]) -> dict[str, Any]:
    """Return the ledger's entry of a task: figures by row, and the logs' hashes."""
    from evaluation.people.folders import episode_table

    table = episode_table(placed)
    rows = {one.replayed.robot.name: _row(one) for one in placed}
    named = table.with_columns(pl.col("ego").replace_strict(rows).alias("row"))
    return {
        "task": task,
        "env_version": placed[0].replayed.recorded.log.environment,
        "methods": {
            name: {
                "people": part["partner_team"].n_unique(),
                "episodes": part.height,
                "caring_success": float(part["success"].to_numpy().mean()),
                "return": float(part["return"].to_numpy().mean()),
            }
            for (name,), part in sorted(named.group_by("row"))
        },
        "logs": sorted(one.replayed.recorded.sha256 for one in placed),
    }


def _row(one: "Placed") -> str:
    """Return the name of a robot's row: the method of a published robot, see `Catalogue`."""
    card = one.replayed.robot.card
    return f"{card.algorithm} ego" if card else one.replayed.robot.name
