"""The text of the results' page: what its first screen says, from the rows' figures."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import polars as pl

from assistax_base.errors import listing
from evaluation.figures.contrasts import ContrastFigure
from evaluation.figures.league import FIRST, LAST, PPO, SCRIPT, TOLD, League, LeagueRow
from evaluation.plots.league import FAILED, failures
from evaluation.record.record import Record
from tools.league.rows import rows

LIMITS = """- Persons are numbers and a program. Nothing here is about people, or about partners
  that are networks.
- The persons of the test side are corners of the training side's range (`spring`), or move by
  another law (`muscle`).
- Checkpoints of all rows are chosen by the validation side, except those of best responses and of
  the mirror. These met the test side and stay as they are at the end of training.
- Hyperparameters are those of PPO's gates for all methods. A method may be better with its own.
"""


@dataclasses.dataclass(frozen=True)
class Played:
    """What the page says of a task."""

    league: League
    folder: Path  # of the task, with a folder for each row

    @property
    def task(self) -> str:
        """Its name."""
        return self.league.context.task

    @property
    def methods(self) -> list[LeagueRow]:
        """Return the rows of methods, PPO among them, the best first."""
        bounds = {*FIRST, *LAST} - {PPO}
        found = [row for row in self.league.rows if row.row not in bounds]
        return sorted(found, key=lambda row: -row.mean.mean)

    def row(self, name: str) -> LeagueRow | None:
        """Return a row by its name; None if it was not played."""
        return next((row for row in self.league.rows if row.row == name), None)

    def by_family(self, row: str) -> dict[str, float]:
        """Return the mean return of a row with the partners of each algorithm, or family."""
        table = Record.read(self.folder / row).table
        means = table.group_by("partner_algorithm").agg(pl.col("return").mean())
        return dict(sorted(means.iter_rows()))


def results_page(
    tasks: Sequence[Played],
    contrasts: Sequence[ContrastFigure],
    records: pl.DataFrame,
    places: Mapping[str, str],
    figures: Mapping[str, str],
) -> str:
    """Return the page in Markdown.

    Args:
        tasks: What was played.
        contrasts: Those that were named, with their figures.
        records: A row of each row's making: `steps` and `device_minutes_in_all`.
        places: Links: "images" and "tables", relative to the page.
        figures: What they show, by name.
    """
    images, tables = places["images"], places["tables"]
    said = "\n".join(
        f"{place}. {text}" for place, text in enumerate(sentences(tasks, contrasts), 1)
    )
    missing = [
        f"`{task.task}`: {listing([f'`{name}`' for name in rows() if task.row(name) is None], 20)}"
        for task in tasks
    ]
    minutes = [taken for taken in records["device_minutes_in_all"] if taken is not None]
    cost = f"{sum(minutes):.0f} minutes of processes for {len(minutes)} rows"
    parts = [
        "# Results",
        "*This page is made from the rows' files by `python -m tools.league page`. "
        "[A league](league.md) says what its words mean.*",
        said,
        *(f"![{what}]({images}/{name}.png)" for name, what in figures.items()),
        "## Tables",
        _contrast_lines(contrasts),
        f"As CSV, in `{tables}`: all rows, the return with each partner, learning curves, "
        f"contrasts, and what each row took ({cost}).",
        "## What the league cannot say",
        f"{LIMITS}- Rows that were not played: {'; '.join(missing)}.",
    ]
    return "\n\n".join(parts) + "\n"


def sentences(tasks: Sequence[Played], contrasts: Sequence[ContrastFigure]) -> Iterator[str]:
    """Yield what the first screen says, ten sentences at most for two tasks."""
    for task in tasks:
        best = task.methods[0]
        beside = {"PPO": PPO, "the script": SCRIPT, "a robot that is told the preference": TOLD}
        known = [(what, task.row(name)) for what, name in beside.items() if name != best.row]
        others = [f"{what} {_figure(row)}" for what, row in known if row]
        yield (
            f"**Of the methods `{best.row}` earns most in `{task.task}`**: {_figure(best)}; "
            f"{', '.join(others)}."
        )
    for found, words in ((True, "Above PPO"), (False, "Not shown to be above PPO")):
        some = [c for c in contrasts if c.named and (c.found and c.difference.mean > 0) == found]
        if some:
            said = [_contrast(contrast, detectable=not found) for contrast in some]
            yield f"{words} at Holm's 5% over all named contrasts: {listing(said)}."
    gaps = [said for task in tasks if (said := _gap(task))]
    if gaps:
        yield f"Of what being told the preference is worth, {listing(gaps)}."
    for task in tasks:
        yield _whom(task)
    shares = [
        f"{row.seed_sd / row.mean.mean:.0%} for `{row.row}` in `{task.task}`"
        for task in tasks
        if (row := task.methods[0]).seed_sd is not None
    ]
    yield f"Seeds differ: their standard deviation is {listing(shares)} of the mean."


def _figure(row: LeagueRow) -> str:
    ends = row.mean.mean_ci
    return f"{row.mean.mean:.0f}" + (f" [{ends[0]:.0f}, {ends[1]:.0f}]" if ends else "")


def _contrast(contrast: ContrastFigure, *, detectable: bool) -> str:
    said = f"`{contrast.method}` in `{contrast.task}` ({contrast.difference.mean:+.0f}"
    if detectable:
        return f"{said}, where {contrast.detectable_holm:.0f} would have been found in 80%)"
    low, high = contrast.difference.mean_ci or (float("nan"),) * 2
    return f"{said} [{low:.0f}, {high:.0f}])"


def _gap(task: Played) -> str | None:
    """Return which share of what telling is worth the best method without it wins."""
    plain, told, best = task.row(PPO), task.row(TOLD), task.methods[0]
    if not plain or not told or told.mean.mean <= plain.mean.mean or best.row == PPO:
        return None
    gap = told.mean.mean - plain.mean.mean
    won = (best.mean.mean - plain.mean.mean) / gap
    return f"`{best.row}` wins {won:.0%} of {gap:.0f} points in `{task.task}`"


def _whom(task: Played) -> str:
    """Say with whom the best method does badly, and whom one should choose it for."""
    best = task.methods[0]
    fails = failures(task.league.by_partner).filter(row=best.row)
    earned = {row.row: task.by_family(row.row) for row in task.methods}  # each is a whole table
    count, families = int(fails["fails"].sum()), earned[best.row]
    apart = listing([f"{mean:.0f} with `{name}`" for name, mean in families.items()])
    winners = {name: max(earned, key=lambda row, name=name: earned[row][name]) for name in families}
    same = set(winners.values()) == {best.row}
    choice = (
        f"choose `{best.row}` for all"
        if same
        else f"choose {listing([f'`{row}` for `{name}`' for name, row in winners.items()])}"
    )
    touch = ""
    if best.safe_success and best.violations:
        safe, hurt = best.safe_success.mean, best.violations.mean
        touch = (
            f"is safe and successful in {safe:.0%} of episodes, presses too hard in {hurt:.0%}, "
        )
    return (
        f"In `{task.task}` {choice}: `{best.row}` earns {apart}, {touch}and fails (below "
        f"{FAILED:.0%} of the best row) with {count} of {fails.height} persons."
    )


def _contrast_lines(contrasts: Sequence[ContrastFigure]) -> str:
    lines = [
        "| contrast | task | difference | p | p by Holm | detectable |",
        "|---|---|---|---|---|---|",
    ]
    for c in contrasts:
        low, high = c.difference.mean_ci or (float("nan"),) * 2
        holm = "not named" if c.p_holm is None else f"{c.p_holm:.4f}"
        lines.append(
            f"| `{c.method}` - `{c.baseline}` | `{c.task}` | {c.difference.mean:.0f} [{low:.0f}, "
            f"{high:.0f}] | {c.p:.4f} | {holm} | {c.detectable_holm:.0f} |"
        )
    return "\n".join(lines)
