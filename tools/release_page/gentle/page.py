"""The whole page: sections in order, and in short what they say."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from assistax_envs.versions import GENTLE_TASKS
from tools.release_page.crossplays import heatmap
from tools.release_page.data import Played
from tools.release_page.gentle.data import MIRROR, SERIES, Results
from tools.release_page.gentle.evaluations import REFERENCES
from tools.release_page.gentle.measures import Comparison
from tools.release_page.gentle.sections import (
    METHOD,
    adaptation,
    comparisons,
    cross_play,
    differences,
    diverse,
    equal_steps,
    gain,
    lost,
    mean,
    method_rows,
    p_value,
    population,
    split_costs,
    splits,
)
from tools.release_page.making import HEADINGS, commands, cost_rows
from tools.release_page.markdown import MISSING, code, csv_of, csv_table, spoken, table
from zoo.schema import PolicyEntry

ALPHA = 0.05  # below it, a p after Holm's correction counts as a difference
TOLD = ("ppo", "ppo-told")  # what knowing a partner's preference is worth
RECURRENT = "ppo-gru"
METHODS = (
    "[methods.csv]({folder}/methods.csv) has what each method earned on each split. M is the mean "
    "return over partners; the gap is M_train - M_test. Safe success is the share of episodes with "
    "test partners that reach the goal without a contact above the hard limit; violations is the "
    "share with such a contact. Intervals resample seeds and partners. Robots that trained with "
    "the test side are not listed. [Releases](../releases.md#which-method-is-best) has M_test and "
    "safe success on the default splits."
)
MORE = {  # tables beside the page
    "population.csv": "teams by algorithm, steps of training and disability setting: how many, and "
    "the IQM of their returns in self-play. Intervals resample teams.",
    "equal-steps.csv": "self-play of algorithms that trained for equally many steps, within 5%, in "
    "the settings that all of them have.",
    "splits.csv": f"every split, the default one first, and its cost. `ppo{MIRROR}` was trained "
    "with the test side, `ppo` with the training side, and both play with the test partners. "
    f"*Lost* is the return of `ppo{MIRROR}` minus that of `ppo`, and its share of the former where "
    "that is surely above zero. Intervals resample the seeds of each, and the partners of both "
    "together. Custom splits are by behaviour: humans fall into two groups by which robots suit "
    "them, and the group that earns more is held out.",
    "differences.csv": "M_test of every two methods on the default splits. p is two-sided, by the "
    "bootstrap of seeds and partners; the least is 0.001. Holm's correction is for all differences "
    "of a task.",
    "series.csv": "mean return with test partners by place in a series of five episodes, on the "
    "default splits. A recurrent robot remembers its partner within the series; a feed-forward one "
    "does not.",
}


def make_page(results: Results, pictures: str, command: str) -> str:
    """Return the page as Markdown.

    Args:
        results: What there is of the release.
        pictures: Folder of the figures, relative to the page.
        command: The command that makes the page, for its last section.
    """
    parts = {
        "In short": in_short(results),
        "Methods": METHODS.format(folder=results.release),
        "More tables": more_tables(results.release),
        "Cross-play": cross_play(results, pictures),
        "Diversity": diverse(results),
        "How this was made": _cost_of_making(results, command),
    }
    head = (
        f"# Release {results.release}: people who like different things\n\n"
        "Returns with their 95% bootstrap intervals. This page is made from the registry and "
        "committed tables by the command at its end. A *team* is a robot and a human that learned "
        "together; an *ego* is a robot that learned with the training partners of a split. "
        "Intervals of fewer than 16 seeds or partners are too narrow. In these tables all partners "
        "played the same starts, so no interval here speaks of other starts."
    )
    return "\n\n".join([head, *(f"## {name}\n\n{text}" for name, text in parts.items())]) + "\n"


def more_tables(folder: str) -> str:
    """Return a list of the tables beside the page: which there are, and how each is measured."""
    return "\n".join(f"- [{name}]({folder}/{name}): {what}" for name, what in MORE.items())


def in_short(results: Results) -> str:
    """Return what the default splits cost, and which methods differ on them."""
    costs, compared = split_costs(results), comparisons(results)
    rows: list[list[str]] = []
    for task in GENTLE_TASKS:
        default = [lost(costs[split.id])[-1] for split in results.splits[task][:1]] or [MISSING]
        rows.append([spoken(task), *default, *_in_short(results, task, compared[task])])
    headings = ["task", "lost", "differ", "do not differ", f"`{TOLD[0]}` - `{TOLD[1]}`"]
    headings += [f"`{RECURRENT}`: last - first"]
    return (
        f"{table(headings, rows, (1, 4, 5))}\n\nOn the default splits. *Lost*: the share of M_test "
        "that a robot loses by training with the training side instead of the test side. *Differ*: "
        f"trained methods that are not told the preference, with p below {ALPHA:g} after Holm's "
        "correction, the better one first. The last columns have the value of being told the "
        "preference, and the gain of a memory within a series. [More tables](#more-tables) says "
        "how each is measured."
    )


def _in_short(results: Results, task: str, comparison: Comparison) -> list[str]:
    trained = {
        pair: result for pair, result in comparison.items() if not {*pair} & {*REFERENCES, TOLD[1]}
    }
    apart = {
        pair: result
        for pair, result in trained.items()
        if result.adjusted is not None and result.adjusted < ALPHA
    }
    better = [
        " > ".join(f"`{name}`" for name in (pair if result.difference.mean > 0 else pair[::-1]))
        for pair, result in apart.items()
    ]
    alike = [f"`{a}`, `{b}`" for a, b in trained if (a, b) not in apart]
    named = ["; ".join(names) or ("–" if trained else MISSING) for names in (better, alike)]
    knowing = comparison.get(TOLD)
    worth = f"{mean(knowing.difference)}, p {p_value(knowing.adjusted)}" if knowing else MISSING
    egos = results.on_default(task, series=True).get(f"{RECURRENT}{SERIES}")
    return [*named, worth, gain(egos) if egos else MISSING]


def figures(results: Results) -> dict[str, Callable[[], Figure]]:
    """Return what draws each figure that the data allow, by the name of its file."""
    return {
        f"crossplay_{task}.png": partial(heatmap, played)
        for task, played in results.crossplay.items()
    }


def tables(results: Results) -> dict[str, str]:
    """Return the files beside the page, in a folder named after the release."""
    methods = (
        [spoken(task), split, *row]
        for task in GENTLE_TASKS
        for split, rows in method_rows(results, task).items()
        for row in rows
    )
    apart = {
        "population": population,
        "equal-steps": equal_steps,
        "splits": splits,
        "differences": differences,
        "series": adaptation,
    }
    beside = {
        f"{name}.csv": csv_of({spoken(t): section(results, t) for t in GENTLE_TASKS}, "task")
        for name, section in apart.items()
    }
    parts = [_made(results, task) for task in GENTLE_TASKS]
    rows = (row for part in parts for row in cost_rows(*part))
    lines = (line for _, trained, played in parts for line in commands(trained, played))
    return beside | {
        "methods.csv": csv_table(("task", "split", *METHOD), methods),
        "minutes.csv": csv_table(HEADINGS, rows),
        "commands.txt": "".join(f"{line}\n" for line in lines),
    }


def _cost_of_making(results: Results, command: str) -> str:
    """Return where minutes and commands of every table are; `command` makes the page."""
    folder = results.release
    return (
        f"[minutes.csv]({folder}/minutes.csv) has the device minutes of every part, "
        f"[commands.txt]({folder}/commands.txt) its command. Minutes are those of one process; up "
        "to twelve processes shared a GPU. `ppo-mirror` was trained with the split's sides "
        f"exchanged. This command makes the page:\n\n{code(command)}"
    )


def _made(
    results: Results, task: str
) -> tuple[list[PolicyEntry], dict[str, Mapping[str, Any]], dict[str, Played]]:
    """Return teams, trainings and plays of a task, as `cost_rows` takes them."""
    humans = [human for human in results.humans if human.task == task]
    trained: dict[str, Mapping[str, Any]] = {
        f"{method} egos, {split}": training
        for (of, split, method), training in results.trained.items()
        if of == task
    }
    played: dict[str, Played] = {
        f"cross-play of {spoken(of)}": crossed
        for of, crossed in results.crossplay.items()
        if of == task
    }
    played |= {
        f"evaluation of {method} egos, {split}": egos
        for (of, split, method), egos in results.egos.items()
        if of == task
    }
    return humans, trained, played
