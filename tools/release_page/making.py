"""Commands that made a page's tables, their devices and minutes."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from assistax_base.errors import counted
from assistax_envs.versions import VERSIONS
from tools.release_page.data import Played
from tools.release_page.markdown import spoken
from zoo.schema import PolicyEntry, Training

# A robot of an evaluation, which had an option before it when the paper's tables were made.
_ROBOT = re.compile(r"(--policy[ =])?(\S+\.safetensors)(?=\s|$)")
_TASKS = list(VERSIONS)
HEADINGS = ("what", "how much", "device", "backend", "device minutes")


def cost_rows(
    humans: Sequence[PolicyEntry],
    trained: Mapping[str, Mapping[str, Any]],
    played: Mapping[str, Played],
) -> list[list[object]]:
    """Return a row of `HEADINGS` for every part.

    Args:
        humans: Humans of the release's teams, whose training is listed.
        trained: Trainings of egos, by label.
        played: Cross-plays and evaluations, by label.
    """
    return [
        *_team_rows(humans),
        *([f"training {name}", *_ego_cells(run)] for name, run in trained.items()),
        *([name, *_played_cells(result)] for name, result in played.items()),
    ]


def commands(trained: Mapping[str, Mapping[str, Any]], played: Mapping[str, Played]) -> list[str]:
    """Return the known commands, each once; the arguments are those of `cost_rows`."""
    runs = (*trained.values(), *(result.run for result in played.values()))
    every = dict.fromkeys([*(run.get("command", "") for run in runs)])
    return [_shortened(command) for command in every if command]


def _team_rows(everyone: Sequence[PolicyEntry]) -> list[list[object]]:
    """Return a row for each task and algorithm of the registry's teams."""
    kinds: dict[tuple[str, str], list[PolicyEntry]] = {}
    for human in sorted(everyone, key=lambda human: (_TASKS.index(human.task), human.algorithm)):
        kinds.setdefault((human.task, human.algorithm), []).append(human)
    rows: list[list[object]] = []
    for (task, algorithm), humans in kinds.items():
        runs = list({human.run: human.training for human in humans}.values())
        much = f"{counted(len(humans), 'team')}, {_steps(runs)} steps each"
        minutes = _minutes([run.seconds for run in runs])
        rows.append([f"training {spoken(task)} {algorithm.upper()}", much, *_where(runs), minutes])
    return rows


def _ego_cells(run: Mapping[str, Any]) -> list[object]:
    """Return the cells of an ego training."""
    much = f"{counted(run['egos'], 'ego')}, {run['steps'] / 1e6:.3g} M steps each"
    place = [run.get("device") or "–", run.get("backend") or "–"]
    return [much, *place, _minutes([run.get("seconds")])]


def _played_cells(played: Played) -> list[object]:
    """Return the cells of a cross-play or an evaluation."""
    run, summary = played.run, played.summary
    much = (
        f"{summary['episodes']:,} episodes, {summary['episodes_per_pair']} a pair, "
        f"{summary['nonfinite']} non-finite"
    )
    devices = ", ".join(sorted(set(run.get("devices", [])))) or "–"
    return [much, devices, summary["backend"], _minutes([run["seconds"]])]


def _steps(runs: Sequence[Training]) -> str:
    counts = sorted({round(run.steps / 1e6, 1) for run in runs})
    return f"{counts[0]:g} M" if len(counts) == 1 else f"{counts[0]:g} to {counts[-1]:g} M"


def _where(runs: Sequence[Training]) -> list[str]:
    devices, backends = {run.device for run in runs if run.device}, {run.backend for run in runs}
    return [", ".join(sorted(devices)) or "–", ", ".join(sorted(backends))]


def _minutes(seconds: Sequence[float | None]) -> str:
    """Return the sum of known seconds in minutes, and the number of unknown ones."""
    known = [value for value in seconds if value is not None]
    if not known:
        return "–"
    return f"{sum(known) / 60:.1f}" + (
        "" if len(known) == len(seconds) else f", {len(seconds) - len(known)} unknown"
    )


def _shortened(command: str) -> str:
    """Return a command in which the robots of many seeds are the first and a number."""
    robots = _ROBOT.findall(command)
    if len(robots) < 3:
        return command
    rest = re.sub(r" {2,}", " ", _ROBOT.sub("", command)).strip()
    option, first = robots[0]
    word = option.strip(" =") or "robots"
    return f"{rest} {option.replace('=', ' ')}{first}  # and {len(robots) - 1} more {word}"
