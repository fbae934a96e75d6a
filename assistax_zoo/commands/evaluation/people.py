"""The command that reads logs of episodes in which visitors of the page were the person."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assistax_base.errors import counted, printable
from assistax_zoo.commands.options import Source
from assistax_zoo.shell.console import answer, first_lines, stdout_is_data
from zoo.registry import load_registry

if TYPE_CHECKING:
    from evaluation.people.beside import Beside
    from evaluation.people.study import People, TaskFigures

_WORDS = {"return": "return", "success": "caring success", "discomfort_share": "discomfort"}


def people(
    folder: Path,
    /,
    *,
    out: Path,
    beside: tuple[Path, ...] = (),
    episodes: int | None = None,
    persons: int = 0,
    steps: Literal["parquet", "minari", "lerobot"] | None = None,
    source: Source = Source(),
    json: bool = False,
) -> None:
    """Read logs of the browser page into results, and compare people with persons.

    Each log is played again as `replay` does. Those that fit their episodes become result folders,
    one for each task and robot, which compare, report and plot take. The partner is
    people/NAME, by the subfolder that a log lies in; a log beside the subfolders is a person of its
    own. people.json in the output folder lists every file, also the refused ones, with the reason.
    No log proves that a person played.

    Args:
        folder: Logs that the page saved; a subfolder holds those of one person. Use no names.
        out: Folder for the results, OUT/TASK/ROBOT.
        beside: Result of the same robots with persons, which evaluate filled; repeat it for more.
            Ranks with people stand beside ranks with persons, with Kendall's tau.
        episodes: Episodes of each person with each robot; people with fewer are left out. Default:
            as many as the person with the fewest has.
        persons: Persons of each family to play with each robot, whose pace, delay, force and words
            stand beside the people's. This takes a minute or two for each robot.
        steps: Also write every step, as `trajectories` does, into OUT/steps, in this format.
        source: Where robots come from.
        json: Print JSON.

    Example:
        assistax-zoo people logs --out results/people --beside results/s0 --beside results/s1
    """
    with stdout_is_data():
        from assistax_envs.interrupts import interruptible
        from assistax_zoo.recording import record_people
        from evaluation.people.study import read_people
        from evaluation.record import tables

        registry = load_registry(source.registry)
        options: dict[str, Any] = {"episodes": episodes, "persons": persons}

        def read(check: Callable[[], None]) -> "People":
            def also(result: Path, placed: Any) -> None:
                if steps is not None:
                    record_people(result, placed, out / "steps", steps, check)

            given: dict[str, Any] = {
                **options,
                "beside_results": beside,
                "check": check,
                "also": also,
            }
            return read_people(folder, out, registry, **given)

        found = interruptible(read)
    answer(json, tables.to_json(found), *map(printable, _lines(found)))


def _lines(found: "People") -> list[str]:
    """Return the answer for a reader."""
    lines = [f"refused: {path}: {why}" for path, why in found.refused.items()]
    lines += [f"left out: {path}: {why}" for path, why in found.left_out.items()]
    counts = (
        f"{len(found.accepted)} accepted, {len(found.left_out)} left out, {len(found.refused)} "
        "refused"
    )
    return [
        *first_lines("", lines, "file"),
        f"{counted(found.logs, 'log')} of {found.folder}: {counts}; no log proves a person",
        *(line for task in found.tasks for line in _task_lines(task)),
    ]


def _task_lines(task: "TaskFigures") -> list[str]:
    """Return the lines about a task: robots, ranks, behaviour."""
    from evaluation.people.behaviour import NAMES

    people = "1 person" if task.people == 1 else f"{task.people} people"
    lines = [f"{task.task}: {counted(task.episodes, 'episode')} of {people}"]
    for folder, summary in task.robots.items():
        earned, caring, hurt = summary.m_test, summary.caring_success, summary.discomfort
        assert earned and caring and hurt  # all people are of the test side of a gentle task
        ends = " [{:.1f}, {:.1f}]".format(*earned.mean_ci) if earned.mean_ci else ""
        lines.append(
            f"  {summary.egos[0]}: return {earned.mean:.1f}{ends}, caring success "
            f"{caring.mean:.0%}, discomfort {hurt.mean:.0%} of felt steps; {folder}"
        )
    lines += [line for ranked in task.beside for line in _rank_lines(ranked)]
    for name, unit in NAMES.items():
        shown = [f"people {_quartiles(task.behaviour[name])}"]
        if task.persons:
            shown.append(f"persons {_quartiles(task.persons[name])}")
        lines.append(f"  {name}, {unit}, quartiles over episodes: {'; '.join(shown)}")
    return lines


def _rank_lines(ranked: "Beside") -> list[str]:
    """Return a line about the robots by one column, and one about the agreement."""
    word = _WORDS[ranked.column]
    rows = zip(ranked.robots, ranked.people, ranked.persons, strict=True)
    means = "; ".join(f"{robot} {mine:.3g} and {theirs:.3g}" for robot, mine, theirs in rows)
    lines = [f"  {word} with people and with persons, best with people first: {means}"]
    if ranked.agreement is None:
        return [*lines, f"  Kendall's tau of {word}: none, of one robot or of equal ones"]
    tau, robots = ranked.agreement.tau, len(ranked.robots)
    ends = " [{:.2f}, {:.2f}]".format(*tau.value_ci) if tau.value_ci else ""
    return [*lines, f"  Kendall's tau of {word}: {tau.value:.2f}{ends}, {robots} robots"]


def _quartiles(found: Any) -> str:
    """Return the quartiles of a distribution in a few characters."""
    if found.quartiles is None:
        return "none"
    low, middle, high = found.quartiles
    return f"{low:.2f}, {middle:.2f}, {high:.2f} of {found.episodes}"
