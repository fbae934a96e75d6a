"""Logs played again and compared with the episodes that their actions give.

The recorded actions of both seats are played from the recorded start, which gives the page's
physics and with it the exact reward. The robot's actions are computed again from what it observed
in that play, the human's words among it, and compared with the recorded ones. So no robot can be
made better or worse by a changed log. The human's actions and words can be anything: no log proves
that a person played.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from assistax_envs.preferences import PREFERRED
from evaluation.people.log import PAGE, LogError, Recorded, Robot, read_log
from evaluation.people.playing import AT_ONCE, Played, play
from evaluation.people.robots import SeatRobot, robot_of
from evaluation.play.rows import measured
from zoo.registry import Registry

# Most that the recorded actions of a network, and of a script, may differ from those computed here:
# the page and XLA round differently in the last bits, and scripts divide by small numbers.
MOST_OFF, SCRIPT_OFF = 1e-5, 5e-3
FIGURE_OFF = 1e-4  # the same of a figure, as a share of it; below 1 absolutely


@dataclasses.dataclass(frozen=True, eq=False)
class Replayed:
    """A log that fits the episode played again."""

    recorded: Recorded
    robot: SeatRobot
    figures: Mapping[str, Any]  # measured columns of the episode table, from the play here
    steps: Mapping[str, np.ndarray]  # what each step gave, [T, ...]
    off: float  # largest difference of the robot's recorded actions from those computed here


@dataclasses.dataclass(frozen=True)
class Refused:
    """A log that is refused."""

    path: Path
    why: str


def replay_log(path: Path, registry: Registry) -> Replayed:
    """Return a log that was played again.

    Raises:
        LogError: The log is no log, or does not fit the episode.
    """
    [outcome] = replay_logs([path], registry)
    if isinstance(outcome, Refused):
        raise LogError(f"{outcome.path}: {outcome.why}")
    return outcome


def replay_logs(
    paths: Sequence[Path], registry: Registry, check: Callable[[], None] = lambda: None
) -> list[Replayed | Refused]:
    """Return each file as a log that was played again, or as refused with a reason, in order.

    Args:
        paths: The files.
        registry: The registry of the robots.
        check: Called before logs are played, some at once; it may raise to stop.
    """
    outcomes: dict[Path, Replayed | Refused] = {}
    groups: dict[tuple[str, str, str | None], list[Recorded]] = {}
    for path in paths:
        try:
            recorded = read_log(path)
        except LogError as error:
            outcomes[path] = Refused(path, str(error).removeprefix(f"{path}: "))
            continue
        robot = recorded.log.robot
        groups.setdefault((recorded.log.task, robot.name, robot.sha256), []).append(recorded)
    for (task, name, sha256), logs in groups.items():
        try:
            robot = robot_of(task, Robot(name=name, sha256=sha256), registry)
        except LogError as error:
            outcomes |= {one.path: Refused(one.path, str(error)) for one in logs}
            continue
        for part in (logs[at : at + AT_ONCE] for at in range(0, len(logs), AT_ONCE)):
            check()
            for one, outcome in zip(part, _compared(part, robot), strict=True):
                outcomes[one.path] = outcome
    return [outcomes[path] for path in paths]


def _compared(logs: Sequence[Recorded], robot: SeatRobot) -> Iterator[Replayed | Refused]:
    """Yield each log of a robot as played again or refused."""
    played = play(logs)
    again = robot.actions(played.seen, _wishes(logs))
    figures = measured(logs[0].log.task, played.tally)
    for place, one in enumerate(logs):
        mine = {name: _plain(values[place]) for name, values in figures.items()}
        try:
            _check_end(one, played, place)
            off = _check_actions(one, again[: one.log.steps, place])
            _check_figures(one, mine)
        except LogError as error:
            yield Refused(one.path, str(error))
            continue
        yield Replayed(one, robot, mine, played.of(place), off)


def _wishes(logs: Sequence[Recorded]) -> np.ndarray:
    """Return the wishes [N, W] of logs' visitors, in the order of the task's preferences."""
    names = PREFERRED[logs[0].log.task]
    return np.array([[one.log.wish[name] for name in names] for one in logs])


def _check_end(one: Recorded, played: Played, place: int) -> None:
    """Refuse an episode that has not ended at the log's last step, or that broke down."""
    if played.tally.nonfinite[place]:
        raise LogError("the physics of its actions broke down, so that it has no result; leave out")
    if not played.ended[place]:
        took = int(played.tally.steps[place])
        found = f"ends at step {took}" if took < one.log.steps else "has not ended by then"
        raise LogError(
            f"it has {one.log.steps} steps, and the episode of its actions {found}; {PAGE}, and "
            "play it to the end"
        )


def _check_actions(one: Recorded, again: np.ndarray) -> float:
    """Return the largest difference of the robot's actions; refuse more than is allowed."""
    off = np.abs(one.robot - again).max(axis=1)
    most = SCRIPT_OFF if one.log.robot.sha256 is None else MOST_OFF
    wrong = np.flatnonzero(~(off <= most))
    if wrong.size:
        raise LogError(
            f"from step {wrong[0]} on its robot acts otherwise than {one.log.robot.name} does "
            f"after the same start, actions and words: by {off[wrong[0]]:.2g}, where "
            f"{most:g} is allowed; take the file that the page saved"
        )
    return float(off.max())


def _check_figures(one: Recorded, mine: Mapping[str, Any]) -> None:
    """Refuse a result with other figures than the episode played again."""
    said = one.log.result
    if missing := {"return", "success"} - set(said):
        raise LogError(f"its result lacks {' and '.join(sorted(missing))}; {PAGE}")
    for name, value in said.items():
        if name not in mine:
            raise LogError(f"its result has {name!r}, which is no figure of an episode; {PAGE}")
        if not _same(value, mine[name]):
            raise LogError(
                f"its result says {name} {_shown(value)}, and its actions give "
                f"{_shown(mine[name])}; take the file that the page saved"
            )


def _same(said: Any, found: Any) -> bool:
    """Return whether a figure of a log is that of the episode."""
    if type(found) is not float:
        return type(said) is type(found) and said == found
    if type(said) not in (int, float):
        return False
    return math.isclose(said, found, rel_tol=FIGURE_OFF, abs_tol=FIGURE_OFF)


def _plain(value: Any) -> Any:
    """Return a figure as a number, flag or text of Python; None where there was nothing."""
    value = value.item() if isinstance(value, np.generic | np.ndarray) else value
    return None if isinstance(value, float) and math.isnan(value) else value


def _shown(value: Any) -> str:
    return f"{value:.6g}" if type(value) is float else repr(value)[:40]
