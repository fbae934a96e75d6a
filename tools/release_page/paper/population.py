"""The section on the population: Table 6 and Figure 2."""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from assistax_envs.versions import PAPER_TASKS
from tools.release_page.markdown import MISSING, image, spoken, table
from tools.release_page.paper.data import Results, planned

ALGORITHMS = ("ippo", "mappo", "masac")
Picture = Callable[[str], str]  # from a figure's file name to its link


def population(results: Results, picture: Picture) -> str:
    """Return Table 6 and Figure 2."""
    counts = Counter((human.task, human.algorithm) for human in results.humans)
    settings = Counter((human.task, human.algorithm, human.disability) for human in results.humans)
    paper = results.paper["population"]
    rows: list[list[object]] = []
    for name in ALGORITHMS:
        cells = []
        for task in PAPER_TASKS:
            teams = {
                setting: n for (t, a, setting), n in settings.items() if (t, a) == (task, name)
            }
            cells += [
                _made_of(teams),
                f"{planned({name: paper[task][name]})} = {_planned_of(paper[task][name])}",
            ]
        rows.append([name.upper(), *cells])
    totals = [
        (sum(n for (t, _), n in counts.items() if t == task), planned(paper[task]))
        for task in PAPER_TASKS
    ]
    rows.append(["**Total**", *(f"**{n}**" for pair in totals for n in pair)])
    headings = [
        "settings × seeds",
        *(f"{spoken(task)}{of}" for task in PAPER_TASKS for of in ("", ", paper")),
    ]
    ours, planned_teams = (sum(column) for column in zip(*totals, strict=True))
    same = (
        "The composition is the paper's."
        if not _differences(settings, paper)
        else (f"Different from the paper's: {'; '.join(_differences(settings, paper))}.")
    )
    drawn = (
        image(picture("population.png"), "The population by task, algorithm and setting")
        if ours
        else f"Figure 2: {MISSING}."
    )
    return f"{table(headings, rows)}\n\n{ours} of {planned_teams} teams. {same}\n\n{drawn}"


def _made_of(settings: Mapping[str, int]) -> str:
    """Return a number of teams as settings × seeds, or by setting if numbers of seeds differ."""
    if not settings:
        return "0"
    total, sizes = sum(settings.values()), set(settings.values())
    if len(sizes) == 1:
        return f"{total} = {len(settings)} × {sizes.pop()}"
    return f"{total}: {', '.join(f'{name} {n}' for name, n in sorted(settings.items()))}"


def _planned_of(kind: Mapping[str, int]) -> str:
    return f"{kind['settings']} × {kind['seeds']}"


def _differences(
    settings: Mapping[tuple[str, str, str], int], paper: Mapping[str, Any]
) -> list[str]:
    """Return each task and algorithm with a setting whose number of seeds is not the paper's."""
    planned_teams = {
        (task, name, f"d{i + 1}"): kind["seeds"]
        for task, kinds in paper.items()
        for name, kind in kinds.items()
        for i in range(kind["settings"])
    }
    differing = {
        key[:2]
        for key in {*planned_teams, *settings}
        if planned_teams.get(key, 0) != settings.get(key, 0)
    }
    return [f"{spoken(task)} {name.upper()}" for task, name in sorted(differing)]
