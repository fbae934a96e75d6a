"""Which person an episode of a log is of, and which of its episodes it is.

A subfolder is a person: its name is the person's. A log beside the subfolders is a person of its
own. A person with one wish is the partner `people/NAME`; one with several wishes is a partner for
each, `people/NAME.1` and so on, because an adaptation slope is over partners with one wish each.
"""

import dataclasses
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from assistax_base.digest import sha256
from evaluation.people.replaying import Refused, Replayed

PEOPLE = "people"  # begins the ids of partners, and is their algorithm
MOST_LOGS = 2_000  # of which each takes a tenth of a megabyte of memory once played
_PERSON = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,31}")


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """An episode of the tables."""

    replayed: Replayed
    person: str  # name of the folder, or the beginning of the log's hash
    partner: str  # such as "people/p01"
    episode: int  # number among the partner's episodes with this robot


@dataclasses.dataclass(frozen=True, eq=False)
class Grouped:
    """All logs of a folder: episodes, and left-out logs with their reasons."""

    placed: tuple[Placed, ...]
    left_out: tuple[Refused, ...]  # that fit their episodes


def find_logs(folder: Path) -> list[Path]:
    """Return the paths of the JSON files of a folder and of its subfolders, in order.

    Raises:
        ValueError: There is no such folder, no file, or too many; or a subfolder has a name that no
            person can have.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder} is no folder; give one of logs that the page saved")
    paths = sorted([*folder.glob("*.json"), *folder.glob("*/*.json")])
    if not paths:
        raise ValueError(
            f"{folder} and its subfolders have no .json file; put logs there that the page saved"
        )
    if len(paths) > MOST_LOGS:
        raise ValueError(f"{folder} has {len(paths)} files; give at most {MOST_LOGS} at once")
    for path in paths:
        person_of(folder, path)
    return paths


def person_of(folder: Path, path: Path) -> str | None:
    """Return the name of the subfolder that a log lies in; None for one beside the subfolders.

    Raises:
        ValueError: The subfolder has a name that no person can have.
    """
    if path.parent == folder:
        return None
    if not _PERSON.fullmatch(path.parent.name):
        raise ValueError(
            f"{path.parent} is no name of a person; use up to 32 letters, digits, - and _, and no "
            "name that a person bears"
        )
    return path.parent.name


def grouped(folder: Path, logs: Sequence[Replayed], episodes: int | None = None) -> Grouped:
    """Return logs that fit their episodes as episodes of the tables.

    Args:
        folder: The folder that they were found in.
        logs: The logs.
        episodes: Episodes of each partner with each robot of a task; partners with fewer are left
            out. By default as many as the partner with the fewest has.

    Raises:
        ValueError: No partner has so many episodes.
    """
    if episodes is not None and episodes < 1:
        raise ValueError(f"episodes is {episodes}; give at least 1")
    kept, left = _distinct(folder, logs)
    placed: list[Placed] = []
    for task in sorted({one.recorded.log.task for _, one in kept}):
        mine = [(who, one) for who, one in kept if one.recorded.log.task == task]
        here, gone = _of_task(task, mine, episodes)
        placed, left = placed + here, left + gone
    return Grouped(tuple(placed), tuple(left))


def _distinct(
    folder: Path, logs: Sequence[Replayed]
) -> tuple[list[tuple[str, Replayed]], list[Refused]]:
    """Return persons and their logs without repetitions, and the others.

    Logs have a date and no time. Of several tries of a day the log's hash decides which one counts.
    """
    kept: list[tuple[str, Replayed]] = []
    left: list[Refused] = []
    seen: dict[str, Path] = {}
    tried: dict[Any, Path] = {}
    for one in sorted(logs, key=lambda one: (one.recorded.log.saved, one.recorded.sha256)):
        recorded, log = one.recorded, one.recorded.log
        who = person_of(folder, recorded.path) or log.sha256[:12]
        acted = sha256(recorded.human.tobytes() + recorded.words.tobytes())
        same = f"{log.task} {log.robot.name} {log.start} {acted}"
        if same in seen:
            left.append(Refused(recorded.path, f"the same episode as {seen[same]}; it counts once"))
            continue
        seen[same] = recorded.path
        turn = who, log.task, log.robot.name, _turn(one), _wish(one)
        if turn in tried:
            why = f"another try of {tried[turn]}, from the same start; one of them counts"
            left.append(Refused(recorded.path, why))
            continue
        tried[turn] = recorded.path
        kept.append((who, one))
    return kept, left


def _of_task(
    task: str, logs: Sequence[tuple[str, Replayed]], episodes: int | None
) -> tuple[list[Placed], list[Refused]]:
    """Return the episodes of a task, equally many of each partner and robot, and the others."""
    partners = _partners(logs)
    pairs: dict[tuple[str, str], list[tuple[str, Replayed]]] = defaultdict(list)
    # In how many robots' hands a partner's start was: those of all robots come first, so that
    # robots are compared from equal starts.
    common = Counter((partners[who, _wish(one)], _turn(one)) for who, one in logs)
    for who, one in logs:
        pairs[partners[who, _wish(one)], one.robot.member.id].append((who, one))
    count = episodes or min(map(len, pairs.values()))
    placed: list[Placed] = []
    left: list[Refused] = []
    for (partner, robot), mine in pairs.items():
        mine.sort(key=lambda row: (-common[partner, _turn(row[1])], _turn(row[1])))
        enough = len(mine) >= count
        placed += [Placed(one, who, partner, k) for k, (who, one) in enumerate(mine[:count])][
            : count * enough
        ]
        why = f"{partner} has {len(mine)} episodes with {robot}, and {count} of each count"
        left += [Refused(one.recorded.path, why) for _, one in mine[count * enough :]]
    if not placed:
        raise ValueError(
            f"no person has {count} episodes of {task} with one robot; ask for fewer episodes"
        )
    return placed, left


def _partners(logs: Sequence[tuple[str, Replayed]]) -> dict[tuple[str, Any], str]:
    """Return the id of each person with one of its wishes."""
    wishes: dict[str, list[Any]] = defaultdict(list)
    for who, one in sorted(logs, key=lambda row: (_turn(row[1]), row[1].recorded.log.saved)):
        if _wish(one) not in wishes[who]:
            wishes[who].append(_wish(one))
    return {
        (who, wish): f"{PEOPLE}/{who}" + (f".{number}" if len(of_person) > 1 else "")
        for who, of_person in wishes.items()
        for number, wish in enumerate(of_person, 1)
    }


def _turn(one: Replayed) -> tuple[int, int]:
    """Return the block and the start of an episode."""
    log = one.recorded.log
    return log.study.block or 0, log.start


def _wish(one: Replayed) -> tuple[tuple[str, float], ...]:
    return tuple(sorted(one.recorded.log.wish.items()))


def persons_of(placed: Sequence[Placed]) -> Iterator[str]:
    """Yield the name of each person once."""
    yield from dict.fromkeys(one.person for one in placed)
