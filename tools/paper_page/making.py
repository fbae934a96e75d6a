"""The page's last section: which commands made the tables, on what device, in how many minutes."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from assistax_envs.versions import PAPER_TASKS
from tools.paper_page.data import Played, Results
from tools.paper_page.markdown import MISSING, code, spoken, table
from zoo.schema import PolicyEntry, Training

_POLICY = re.compile(r"--policy[ =](\S+)")


HEADINGS = ("what", "how much", "device", "backend", "device minutes")


def made(results: Results, command: str) -> str:
    """Return device minutes of every part, then the commands; `command` makes the page."""
    named: dict[str, Played] = {
        f"cross-play of {spoken(task)}": played for task, played in results.crossplay.items()
    }
    named |= {
        f"evaluation of {m.upper()} egos, {spoken(t)}": egos
        for (t, m), egos in results.egos.items()
    }
    trained = {
        f"training {spoken(task)} {method.upper()} egos": egos.training
        for (task, method), egos in results.egos.items()
        if egos.training
    }
    rows = [*team_rows(results.humans, PAPER_TASKS), *ego_rows(trained), *played_rows(named)]
    runs = (*trained.values(), *(found.run for found in named.values()))
    return costs(rows, [*(run.get("command", "") for run in runs), command])


def costs(rows: Sequence[Sequence[object]], commands: Sequence[str]) -> str:
    """Return rows of HEADINGS as a table, then the commands; one that is empty is not known."""
    shown = table(HEADINGS, rows, (4,)) if rows else f"{MISSING.capitalize()}."
    known = [_shortened(one) for one in dict.fromkeys(commands) if one]
    return "\n\n".join([shown, *([code("\n".join(known))] if known else [])])


def team_rows(everyone: Sequence[PolicyEntry], tasks: Sequence[str]) -> list[list[object]]:
    """Return a row for each task and algorithm of the registry's teams."""
    rows: list[list[object]] = []
    kinds = sorted(
        {(h.task, h.algorithm) for h in everyone},
        key=lambda kind: (tasks.index(kind[0]), kind[1]),
    )
    for task, algorithm in kinds:
        humans = [human for human in everyone if (human.task, human.algorithm) == (task, algorithm)]
        runs = {human.run: human.training for human in humans}
        what = f"training {spoken(task)} {algorithm.upper()}"
        much = f"{len(humans)} teams, {_steps(list(runs.values()))} steps each"
        rows.append(
            [
                what,
                much,
                *_where(list(runs.values())),
                _minutes([run.seconds for run in runs.values()]),
            ]
        )
    return rows


def ego_rows(trained: Mapping[str, Mapping[str, Any]]) -> list[list[object]]:
    """Return a row for each training of egos, by what is said of it."""
    rows: list[list[object]] = []
    for what, told in trained.items():
        much = f"{told['egos']} egos, {told['steps'] / 1e6:.3g} M steps each"
        place = [told.get("device") or "–", told.get("backend") or "–"]
        rows.append([what, much, *place, _minutes([told.get("seconds")])])
    return rows


def played_rows(named: Mapping[str, Played]) -> list[list[object]]:
    """Return a row for each cross-play and evaluation, by what is said of it."""
    rows: list[list[object]] = []
    for what, found in named.items():
        run, told = found.run, found.summary
        much = (
            f"{told['episodes']:,} episodes, {told['episodes_per_pair']} a pair, "
            f"{told['nonfinite']} non-finite"
        )
        devices = ", ".join(sorted(set(run.get("devices", [])))) or "–"
        rows.append([what, much, devices, told["backend"], _minutes([run["seconds"]])])
    return rows


def _steps(runs: Sequence[Training]) -> str:
    counts = sorted({round(run.steps / 1e6, 1) for run in runs})
    return f"{counts[0]:g} M" if len(counts) == 1 else f"{counts[0]:g} to {counts[-1]:g} M"


def _where(runs: Sequence[Training]) -> list[str]:
    devices, backends = {run.device for run in runs if run.device}, {run.backend for run in runs}
    return [", ".join(sorted(devices)) or "–", ", ".join(sorted(backends))]


def _minutes(seconds: Sequence[float | None]) -> str:
    known = [value for value in seconds if value is not None]
    if not known:
        return "–"
    return f"{sum(known) / 60:.1f}" + (
        "" if len(known) == len(seconds) else f", {len(seconds) - len(known)} unknown"
    )


def _shortened(command: str) -> str:
    """Write the policies of many seeds as their first one and a number."""
    policies = _POLICY.findall(command)
    if len(policies) < 3:
        return command
    rest = re.sub(r" {2,}", " ", _POLICY.sub("", command)).strip()
    return f"{rest} --policy {policies[0]}  # and {len(policies) - 1} more --policy"
