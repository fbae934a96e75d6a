"""Stages of the gates of persons: robots that train with persons, and their results with them.

Each kind of robot is a stage: a run in FOLDER/NAME, which can be resumed, and FOLDER/NAME.json with
the results of its robots with persons. `table` reads these files, so that stages may run on
several machines.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from assistax_base.files import write_json
from assistax_workshop.gates.persons.play import Plan
from assistax_workshop.gates.persons.reading import read_wishes
from assistax_workshop.gates.persons.robots import ROBOTS, play_robots
from assistax_workshop.gates.persons.scripts import CAREFUL, play_script, play_told
from assistax_workshop.gates.persons.search import search_script
from assistax_workshop.gates.persons.steals import play_steals
from assistax_workshop.gates.persons.swapped import play_swapped
from assistax_workshop.gates.persons.words import play_words

Stage = Callable[[Plan, Callable[[str], None]], dict[str, Any]]
# Stages beside the robots, by name.
OTHERS: Mapping[str, Stage] = {
    "script": play_script,
    CAREFUL: play_told,
    "search": search_script,
    "search-told": lambda plan, progress: search_script(plan, progress, told=True),
    "read": read_wishes,
    "swapped": play_swapped,
    "words": play_words,
    "steals": play_steals,
}
STAGES = (*ROBOTS, *OTHERS)


def run_stages(
    plan: Plan, stages: Sequence[str] = STAGES, progress: Callable[[str], None] = print
) -> None:
    """Train and play stages; results that the folder holds are not made again.

    Raises:
        ValueError: There is no such stage.
    """
    if unknown := [name for name in stages if name not in STAGES]:
        raise ValueError(f"stage is {unknown[0]!r}; allowed are {', '.join(STAGES)}")
    plan.folder.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(stages, 1):
        progress(f"stage {number} of {len(stages)}, {name}")
        found = play_robots(plan, name) if name in ROBOTS else OTHERS[name](plan, progress)
        write_json(plan.folder / f"{name}.json", found)
        for side, figures in found.get("sides", {}).items():
            mean, caring = (np.mean(figures[what]) for what in ("return", "success"))
            progress(f"{name} with {side}: return {mean:.1f}, caring success {caring:.0%}")
