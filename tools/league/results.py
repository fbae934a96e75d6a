"""The text of the results' page: what its first screen says, from the rows' figures."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeVar

import polars as pl

from assistax_base.errors import listing
from evaluation.figures.contrasts import Contrast, ContrastsFile
from evaluation.figures.league import (
    BEST_OF_FOUR,
    FIRST,
    LAST,
    PPO,
    RESPONSE,
    SCRIPT,
    TOLD,
    TOLD_MEMORY,
)
from evaluation.figures.metrics.inference import holm
from tools.league.figures import FAILED, failures
from tools.league.rows import rows
from tools.league.tables import Tables, splits_of
from tools.release_page.markdown import table
from zoo.registry import Registry

Shown = TypeVar("Shown", "ShownRow", "ShownContrast")
LIMITS = """- Persons are numbers and a program. Nothing here is about people. With partners that
  are networks [it is otherwise](log/league.md#with-co-trained-teams): for them choose
  [a robot that learned with such partners](log/league.md#robots-that-learned-with-teams).
- The persons of the test side are corners of the training side's range (`spring`), or move by
  another law (`muscle`).
- Checkpoints of all rows are chosen by the validation side, except those of best responses and of
  the mirror. These met the test side and stay as they are at the end of training.
- Hyperparameters are those of PPO's gates for all methods. A method may be better with its own.
- Robots had 50 M steps. [With 200 M steps](log/league.md#what-was-tried-and-what-explains-it)
  `asymmetric` earns 820 in lift, and PPO 678.
"""


@dataclasses.dataclass(frozen=True)
class ShownRow:
    """What the page says of a row."""

    row: str
    partners: int
    mean: float
    low: float | None  # ends of the mean's 95% interval
    high: float | None
    safe_success: float | None
    violations: float | None
    seed_sd: float | None


@dataclasses.dataclass(frozen=True)
class Played:
    """What the page says of a task."""

    task: str
    rows: tuple[ShownRow, ...]
    by_partner: pl.DataFrame | None  # none of the training side
    # By row, the mean return of its chosen robots with the validation side.
    validated: Mapping[str, float]

    @property
    def methods(self) -> list[ShownRow]:
        """Return the rows of methods, PPO among them, the best first."""
        bounds = {*FIRST, *LAST} - {PPO}
        found = [row for row in self.rows if row.row not in bounds]
        return sorted(found, key=lambda row: -row.mean)

    @property
    def best(self) -> ShownRow:
        """The method that the validation side chooses; without one for each, that of most return.

        What is best with the test side is no choice: its return would be too high.
        """
        if all(row.row in self.validated for row in self.methods):
            return max(self.methods, key=lambda row: self.validated[row.row])
        return self.methods[0]

    @property
    def told(self) -> ShownRow | None:
        """The better of the robots that are told the preference, with a memory or without."""
        found = [row for name in (TOLD, TOLD_MEMORY) if (row := self.row(name))]
        return max(found, key=lambda row: row.mean, default=None)

    def row(self, name: str) -> ShownRow | None:
        """Return a row by its name; None if it was not played."""
        return next((row for row in self.rows if row.row == name), None)

    def by_family(self, row: str) -> dict[str, float]:
        """Return the mean return of a row with the partners of each algorithm, or family."""
        assert self.by_partner is not None
        own = self.by_partner.filter(row=row)
        return dict(sorted(own.group_by("family").agg(pl.col("mean").mean()).iter_rows()))


@dataclasses.dataclass(frozen=True)
class ShownContrast:
    """What the page says of a contrast."""

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
        figures: What they show, by name.
        registry: Where published robots are.
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
    contrasts, asked = (), ()
    if named and shown.contrasts is not None:
        contrasts, asked = tuple(_of_table(ShownContrast, shown.contrasts)), named.contrasts
    alpha = named.alpha if named else 1.0
    images, tables = places["images"], places["tables"]
    said = "\n".join(
        f"{place}. {text}"
        for place, text in enumerate(sentences(tasks, contrasts, asked, alpha, trained), 1)
    )
    missing = [
        f"`{task.task}`: {listing(names, 20)}"
        for task in tasks
        if (names := [f"`{name}`" for name in rows() if task.row(name) is None])
    ]
    unplayed = f"- Rows that were not played: {'; '.join(missing)}." if missing else ""
    # The best of each four seeds are another row's robots: its training is not counted twice.
    made = shown.records.filter(pl.col("row") != BEST_OF_FOUR)
    minutes = [taken for taken in made["device_minutes_in_all"] if taken is not None]
    cost = f"{sum(minutes):.0f} minutes of processes for {len(minutes)} rows"
    parts = [
        "# Results",
        "*This page is made from the rows' files by `python -m tools.league page`. "
        "[A league](league.md) says what its words mean.*",
        _choices(tasks),
        "*Methods are chosen by the validation side. Returns with 95% intervals, over seeds and "
        "persons of the test side. `told` is the better of the robots that are told the "
        "preference, with a memory or without. Fails: earns less than "
        f"{FAILED:.0%} of what the best row earns with that person.*",
        *_published(tasks, splits_of(shown.records), registry),
        said,
        *(f"![{what}]({images}/{name}.png)" for name, what in figures.items()),
        "## Tables",
        _contrast_lines(contrasts, asked),
        f"As CSV, in `{tables}`: all rows, the return with each partner, learning curves, "
        f"contrasts, and what each row took ({cost}).",
        "## What the league cannot say",
        f"{LIMITS}{unplayed}".rstrip(),
    ]
    return "\n\n".join(parts) + "\n"


def _published(
    tasks: Sequence[Played], splits: Mapping[str, str], registry: Registry
) -> Iterator[str]:
    """Yield which published robots learned by the chosen methods with the league's split."""
    wanted = {(task.task, task.best.row, splits.get(task.task)) for task in tasks if task.methods}
    robots = [
        f"`{robot.team}`"
        for robot in registry.policies
        if (met := robot.trained_against) and (robot.task, robot.algorithm, met.split) in wanted
    ]
    if robots:
        yield (
            f"Robots of these methods, to be used by their names: {listing(robots, 20)}. "
            "[Releases](releases.md) says what each of them earns."
        )


def _of_table(kind: type[Shown], table: pl.DataFrame) -> list[Shown]:
    names = [field.name for field in dataclasses.fields(kind)]
    return [kind(**line) for line in table.select(names).iter_rows(named=True)]


def _played(
    task: str, table: pl.DataFrame, partners: pl.DataFrame | None, validated: Mapping[str, float]
) -> Played:
    return Played(task, tuple(_of_table(ShownRow, table)), partners, validated)


def _validated(curves: pl.DataFrame) -> dict[str, float]:
    """Return what each row's robots earn with the validation side, each at its best checkpoint."""
    best = curves.group_by("row", "seed").agg(pl.col("return").max())
    return dict(best.group_by("row").agg(pl.col("return").mean()).iter_rows())


def sentences(
    tasks: Sequence[Played],
    contrasts: Sequence[ShownContrast],
    named: Sequence[Contrast],
    alpha: float,
    trained: Sequence[Played] = (),
) -> Iterator[str]:
    """Yield what the first screen says beside the table of tasks, ten sentences at most.

    Of contrasts it says those with PPO, in return; the tables have all.
    """
    contrasts = [c for c in contrasts if (c.baseline, c.metric) == (PPO, "return")]
    named = [c for c in named if (c.baseline, c.metric) == (PPO, "return")]
    tested = [contrast for contrast in contrasts if contrast.named]
    above = [contrast for contrast in tested if contrast.found and contrast.mean > 0]
    if above:
        said = listing([_contrast(contrast) for contrast in above], 12)
        yield f"Above PPO at Holm's {alpha:.0%} over all named contrasts: {said}."
    if others := _in_tasks([contrast for contrast in tested if contrast not in above]):
        yield (
            f"Not shown to be above PPO: {others}. [The tables](#tables) say which difference "
            "would have been found in 80% of repetitions."
        )
    full = {(c.task, c.method) for c in tested}
    if missed := _in_tasks([c for c in named if (c.task, c.method) not in full]):
        yield f"Named, not played with so many seeds, and so not shown either: {missed}."
    chances = holm([contrast.p for contrast in contrasts])
    unnamed = [
        _contrast(contrast)
        for contrast, chance in zip(contrasts, chances, strict=True)
        if not contrast.named and chance <= alpha and contrast.mean > 0
    ]
    if unnamed:
        yield (
            "Not named before, or played with fewer seeds than named, but above PPO if Holm "
            f"corrects for all {len(chances)} contrasts that were played: {listing(unnamed, 12)}."
        )
    for start, some in (
        ("Of what the better told robot earns more than PPO", [_gap(task) for task in tasks]),
        (
            "Beside robots that were each trained for one person of the test side, all seeds alike",
            _beside(tasks),
        ),
        (
            "Beside robots that were each trained for one training person, the best of each four "
            "seeds",
            _beside(trained),
        ),
    ):
        if said := [text for text in some if text]:
            yield f"{start}, {listing(said, 12)}."
    if better := [_better(task) for task in tasks if task.best is not task.methods[0]]:
        yield f"With the test side another method has a higher mean: {listing(better)}."
    if split := [text for task in tasks if (text := _apart(task))]:
        yield f"No method is best with both families of persons: {listing(split)}."
    shares = [
        f"{row.seed_sd / row.mean:.0%} for `{row.row}` in `{task.task}`"
        for task in tasks
        if (row := task.best).seed_sd is not None
    ]
    if shares:
        yield f"Seeds differ: their standard deviation is {listing(shares, 12)} of the mean."


def _choices(tasks: Sequence[Played]) -> str:
    """Return the table of which method to choose for a task, and what it does badly."""
    headings = "task, choose, return, PPO, script, told, safe success, violations, fails with"
    lines = []
    for task in tasks:
        best = task.best
        rows_beside = (task.row(PPO), task.row(SCRIPT), task.told)
        others = [_figure(row) if row else "" for row in rows_beside]
        known = (best.safe_success, best.violations)
        # Half a percent is shown as one: tables have three digits, and Python rounds 0.5 to 0.
        shares = ["" if share is None else f"{share + 1e-9:.0%}" for share in known]
        assert task.by_partner is not None
        fails = failures(task.by_partner).filter(row=best.row)
        fail = f"{int(fails['fails'].sum())} of {fails.height} persons"
        first = f"`{task.task}`", f"`{best.row}`", f"**{_figure(best)}**"
        lines.append((*first, *others, *shares, fail))
    return table(headings.split(", "), lines)


def _figure(row: ShownRow) -> str:
    return f"{row.mean:.0f}{_ends(row)}"


def _ends(of: ShownRow | ShownContrast) -> str:
    """Return the ends of an interval after a space; nothing where few robots gave none."""
    return "" if of.low is None else f" [{of.low:z.0f}, {of.high:z.0f}]"


def _contrast(contrast: ShownContrast) -> str:
    difference = f"{contrast.mean:+.0f}{_ends(contrast)}"
    return f"`{contrast.method}` in `{contrast.task}` ({difference})"


def _chance(p: float) -> str:
    return f"{p:.4f}" if p >= 0.0001 else "< 0.0001"


def _in_tasks(contrasts: Sequence[Contrast | ShownContrast]) -> str:
    """Return the methods of contrasts, each with its tasks."""
    tasks: dict[str, list[str]] = {}
    for contrast in contrasts:
        tasks.setdefault(contrast.method, []).append(f"`{contrast.task}`")
    said = [f"`{name}` in {' and '.join(where)}" for name, where in tasks.items()]
    return listing(said, 12) if said else ""


def _better(task: Played) -> str:
    """Say which method has the highest mean with the test side, beside the chosen one."""
    most, chosen = task.methods[0], task.best
    returns = f"{most.mean:.0f}, `{chosen.row}` {chosen.mean:.0f}"
    return f"`{most.row}` in `{task.task}` ({returns})"


def _gap(task: Played) -> str | None:
    """Return which share of what the better told robot earns more than PPO the method wins.

    Of less than a tenth of PPO's return no share is said.
    """
    plain, best, told = task.row(PPO), task.best, task.told
    if not plain or best.row == PPO or not told or told.mean < 1.1 * plain.mean:
        return None
    gap = told.mean - plain.mean
    won = (best.mean - plain.mean) / gap
    return f"`{best.row}` wins {won:.0%} of {gap:.0f} points in `{task.task}` (`{told.row}`)"


def _beside(tasks: Sequence[Played]) -> Iterator[str]:
    """Yield which share of best responses' return the best method earns with their persons."""
    for task in tasks:
        if response := task.row(RESPONSE):
            best, earned, bound = task.best.row, task.best.mean, response.mean
            if task.by_partner is not None:  # few partners of the test side have best responses
                own = task.by_partner.filter(row=RESPONSE).select("partner", own="mean")
                both = task.by_partner.filter(row=best).join(own, on="partner")
                earned, bound = (both[name].to_numpy().mean() for name in ("mean", "own"))
            share = f"{earned:.0f} of {bound:.0f} ({earned / bound:.0%})"
            yield f"`{best}` earns {share} in `{task.task}`"


def _apart(task: Played) -> str | None:
    """Say which method is best with each family of persons, where it is not the same."""
    earned = {row.row: task.by_family(row.row) for row in task.methods}  # each is a whole table
    families = earned[task.methods[0].row]
    winners = {name: max(earned, key=lambda row, name=name: earned[row][name]) for name in families}
    if len(set(winners.values())) == 1:
        return None
    said = [f"`{row}` with `{name}`" for name, row in winners.items()]
    return f"{listing(said)} in `{task.task}`"


def _contrast_lines(contrasts: Sequence[ShownContrast], named: Sequence[Contrast]) -> str:
    lines, in_file = [], {(c.task, c.method, c.baseline, c.metric) for c in named}
    for c in contrasts:
        too_few = (c.task, c.method, c.baseline, c.metric) in in_file
        uncorrected = "1, too few seeds" if too_few else "not named"
        holms = uncorrected if c.p_holm is None else _chance(c.p_holm)
        names = f"`{c.method}` - `{c.baseline}`", f"`{c.task}`"
        difference = f"{c.mean:z.0f}{_ends(c)}"
        lines.append((*names, difference, _chance(c.p), holms, f"{c.detectable_holm:.0f}"))
    headings = "contrast, task, difference, p, p by Holm, detectable by Holm"
    return table(headings.split(", "), lines)
