"""The results' page: figures of the rows, for the prose in `templates`."""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import jinja2
import polars as pl

from evaluation.figures.contrasts import Contrast, ContrastsFile
from evaluation.figures.league import (
    BEST_OF_FOUR,
    FIRST,
    KNOWING,
    KNOWING_MEMORY,
    LAST,
    PPO,
    RESPONSE,
    SCRIPT,
)
from evaluation.figures.metrics.inference import holm
from tools.league.figures import FAILED, failures
from tools.league.groups import Groups
from tools.league.rows import rows
from tools.league.tables import Tables, splits_of
from zoo.registry import Registry

Shown = TypeVar("Shown", "ShownRow", "ShownContrast")


@dataclasses.dataclass(frozen=True)
class ShownRow:
    """Row of the page's table."""

    row: str
    partners: int
    mean: float
    low: float | None  # ends of the mean's 95% interval
    high: float | None
    caring_success: float | None
    violations: float | None
    seed_sd: float | None


@dataclasses.dataclass(frozen=True)
class Played:
    """Results of a task on the page."""

    task: str
    rows: tuple[ShownRow, ...]
    by_partner: pl.DataFrame | None  # None for the training side
    # By row, the mean return of its chosen robots with the validation side.
    validated: Mapping[str, float]
    groups: Groups

    @property
    def methods(self) -> list[ShownRow]:
        """Return the rows of methods, PPO among them, the best first."""
        bounds = {*FIRST, *LAST} - {PPO}
        found = [row for row in self.rows if row.row not in bounds]
        return sorted(found, key=lambda row: -row.mean)

    @property
    def best(self) -> ShownRow:
        """The method that the validation side chooses, or the one of largest return.

        A choice by the test side would overstate the return.
        """
        if all(row.row in self.validated for row in self.methods):
            return max(self.methods, key=lambda row: self.validated[row.row])
        return self.methods[0]

    @property
    def told(self) -> ShownRow | None:
        """The better robot that is told the preference, with a memory or without, or None."""
        found = [row for name in (KNOWING, KNOWING_MEMORY) if (row := self.row(name))]
        return max(found, key=lambda row: row.mean, default=None)

    def row(self, name: str) -> ShownRow | None:
        """Return a row by its name; None if it was not played."""
        return next((row for row in self.rows if row.row == name), None)

    @property
    def fails(self) -> list[bool]:
        """Return for each partner whether the best method fails with it."""
        assert self.by_partner is not None
        return failures(self.by_partner).filter(row=self.best.row)["fails"].to_list()

    @property
    def gap(self) -> "Gap | None":
        """Return the share of the told robot's advantage over PPO that the best method wins.

        None if the advantage is below a tenth of PPO's return, or a row is missing.
        """
        plain, best, told = self.row(PPO), self.best, self.told
        if not plain or best.row == PPO or not told or told.mean < 1.1 * plain.mean:
            return None
        points = told.mean - plain.mean
        return Gap(self.task, best.row, told.row, (best.mean - plain.mean) / points, points)

    @property
    def response(self) -> "Response | None":
        """Return the returns of best responses and of the best method with the same persons."""
        if (row := self.row(RESPONSE)) is None:
            return None
        best, earned, bound = self.best.row, self.best.mean, row.mean
        if self.by_partner is not None:  # few partners of the test side have best responses
            own = self.by_partner.filter(row=RESPONSE).select("partner", own="mean")
            both = self.by_partner.filter(row=best).join(own, on="partner")
            earned, bound = (both[name].to_numpy().mean() for name in ("mean", "own"))
        return Response(self.task, best, earned, bound)

    @property
    def winners(self) -> "Winners":
        """Return the best method with each family of persons."""
        earned = {row.row: self.by_family(row.row) for row in self.methods}  # each a whole table
        families = earned[self.methods[0].row]
        best = {
            name: max(earned, key=lambda row, name=name: earned[row][name]) for name in families
        }
        return Winners(self.task, best)

    def by_family(self, row: str) -> dict[str, float]:
        """Return the mean return of a row with the partners of each algorithm, or family."""
        assert self.by_partner is not None
        own = self.by_partner.filter(row=row)
        return dict(sorted(own.group_by("family").agg(pl.col("mean").mean()).iter_rows()))


@dataclasses.dataclass(frozen=True)
class ShownContrast:
    """Contrast of the page's table."""

    task: str
    method: str
    baseline: str
    metric: str
    named: bool
    mean: float
    low: float | None
    high: float | None
    p: float
    p_holm: float | None
    found: bool | None
    detectable_holm: float

    @property
    def key(self) -> tuple[str, str, str, str]:
        """Task, method, baseline and metric, as a file of contrasts names it."""
        return contrast_key(self)


@dataclasses.dataclass(frozen=True)
class Gap:
    """Share of a told robot's points above PPO that a method wins."""

    task: str
    method: str
    told: str
    won: float
    points: float


@dataclasses.dataclass(frozen=True)
class Response:
    """Return of a method with persons, and the best responses' return as its bound."""

    task: str
    method: str
    earned: float
    bound: float


@dataclasses.dataclass(frozen=True)
class Winners:
    """The best method with each family of persons."""

    task: str
    by_family: Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class InTasks:
    """Method and the tasks of a statement about it."""

    method: str
    tasks: Sequence[str]


def results_page(
    shown: Tables,
    named: ContrastsFile | None,
    places: Mapping[str, str],
    figures: Mapping[str, str],
    registry: Registry,
) -> str:
    """Return the page in Markdown.

    Args:
        shown: The tables.
        named: The file of contrasts.
        places: Links: "images" and "tables", relative to the page.
        figures: Captions of the figures, by name.
        registry: Registry of published robots.
    """
    validated = {task: _validated(table) for task, table in shown.validation.items()}
    tasks = [
        _played(task, table, shown.partners[task], validated.get(task, {}))
        for task, table in shown.league.items()
    ]
    trained = [
        _played(task, table, None, validated.get(task, {}))
        for task, table in shown.training.items()
    ]
    contrasts: Sequence[ShownContrast] = ()
    asked: Sequence[Contrast] = ()
    if named and shown.contrasts is not None:
        contrasts, asked = _of_table(ShownContrast, shown.contrasts), named.contrasts
    missing = {task.task: [name for name in rows() if task.row(name) is None] for task in tasks}
    # The best of each four seeds are robots of another row, which counts their training.
    made = shown.records.filter(pl.col("row") != BEST_OF_FOUR)
    return _template("results").render(
        **places,
        tasks=tasks,
        published=list(_published(tasks, splits_of(shown.records, "training_split"), registry)),
        groups=list(dict.fromkeys(name for task in tasks for name in task.groups.names)),
        sentences=sentences(tasks, contrasts, asked, named.alpha if named else 1.0, trained),
        figures=figures,
        contrasts=contrasts,
        named={contrast_key(contrast) for contrast in asked},
        minutes=made["device_minutes_in_all"].drop_nulls().to_list(),
        missing={task: names for task, names in missing.items() if names},
    )


def sentences(
    tasks: Sequence[Played],
    contrasts: Sequence[ShownContrast],
    named: Sequence[Contrast],
    alpha: float,
    trained: Sequence[Played] = (),
) -> list[str]:
    """Return the sentences beside the first screen's table of tasks, ten at most.

    Of contrasts it says those with PPO, in return; the tables have all.
    """
    contrasts = [c for c in contrasts if (c.baseline, c.metric) == (PPO, "return")]
    named = [c for c in named if (c.baseline, c.metric) == (PPO, "return")]
    tested = [contrast for contrast in contrasts if contrast.named]
    above = [contrast for contrast in tested if contrast.found and contrast.mean > 0]
    full = {(c.task, c.method) for c in tested}
    chances = holm([contrast.p for contrast in contrasts])
    winners = [task.winners for task in tasks]
    said = _template("sentences").render(
        alpha=alpha,
        above=above,
        not_above=_in_tasks(contrast for contrast in tested if contrast not in above),
        missed=_in_tasks(c for c in named if (c.task, c.method) not in full),
        played=len(contrasts),
        unnamed=[
            contrast
            for contrast, chance in zip(contrasts, chances, strict=True)
            if not contrast.named and chance <= alpha and contrast.mean > 0
        ],
        gaps=[gap for task in tasks if (gap := task.gap)],
        responses=[response for task in tasks if (response := task.response)],
        trained_responses=[response for task in trained if (response := task.response)],
        outdone=[task for task in tasks if task.best is not task.methods[0]],
        apart=[won for won in winners if len(set(won.by_family.values())) > 1],
        spread=[task for task in tasks if task.best.seed_sd is not None],
    )
    return said.splitlines()


def contrast_key(contrast: Contrast | ShownContrast) -> tuple[str, str, str, str]:
    """Return task, method, baseline and metric of a contrast."""
    return contrast.task, contrast.method, contrast.baseline, contrast.metric


@functools.cache
def _template(name: str) -> jinja2.Template:
    """Return a template of Markdown, in which `spec` formats a number as Python does."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["spec"] = format
    known: dict[str, Any] = {"PPO": PPO, "SCRIPT": SCRIPT, "FAILED": FAILED}
    environment.globals.update(known)
    return environment.get_template(f"{name}.jinja")


def _published(
    tasks: Sequence[Played], splits: Mapping[str, str], registry: Registry
) -> Iterator[str]:
    """Yield the published robots of the chosen methods, trained with the league's split."""
    wanted = {(task.task, task.best.row, splits.get(task.task)) for task in tasks if task.methods}
    for robot in registry.policies:
        met = robot.trained_against
        if met and (robot.task, robot.algorithm, met.split) in wanted:
            yield robot.team


def _of_table(kind: type[Shown], table: pl.DataFrame) -> list[Shown]:
    """Return a dataclass object for each line of a table."""
    names = [field.name for field in dataclasses.fields(kind)]
    return [kind(**line) for line in table.select(names).iter_rows(named=True)]


def _played(
    task: str, table: pl.DataFrame, partners: pl.DataFrame | None, validated: Mapping[str, float]
) -> Played:
    """Return the results of one task."""
    shown = tuple(_of_table(ShownRow, table))
    return Played(task, shown, partners, validated, Groups.of_table(table))


def _validated(curves: pl.DataFrame) -> dict[str, float]:
    """Return the mean return of each row's robots with the validation side, at best checkpoints."""
    best = curves.group_by("row", "seed").agg(pl.col("return").max())
    return dict(best.group_by("row").agg(pl.col("return").mean()).iter_rows())


def _in_tasks(contrasts: Iterable[Contrast | ShownContrast]) -> list[InTasks]:
    """Return the methods of contrasts, each with its tasks."""
    tasks: dict[str, list[str]] = {}
    for contrast in contrasts:
        tasks.setdefault(contrast.method, []).append(contrast.task)
    return [InTasks(name, where) for name, where in tasks.items()]
