"""The rows of a league on a task: methods and references, in one order and on one scale.

A league's folder holds a finished evaluation for each row, in a folder of the row's name, all with
the same partners and starts. A row of best responses has robots for some of the partners, each
trained with one partner.
"""

import dataclasses
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from assistax_envs.persons.rows import OWN_FAMILY, TEAMS, groups_of
from evaluation.figures.bootstrap import Estimate, Interval, estimate
from evaluation.figures.comparable import ADVICE, Evaluated, comparable
from evaluation.figures.metrics.bounds import best_of_robots, share_of_range
from evaluation.figures.metrics.caring import CareFigures, care_figures
from evaluation.figures.metrics.generalisation import GROUPS, mean_of_groups
from evaluation.figures.metrics.variance import variance_components
from evaluation.figures.normalised import COLUMN, RANDOM, SCRIPT, ZERO
from evaluation.figures.notes import ENOUGH
from evaluation.figures.summary import Context
from evaluation.record import tables
from evaluation.record.alike import check_alike
from evaluation.record.columns import VIOLATIONS
from evaluation.record.record import Record, Returns
from population.views import View

FIXED, PPO, BEST_OF_FOUR = "best-fixed", "ppo", "ppo-best-of-4"
# Of robots that observe the preference, without a memory and with one, or a person's numbers.
KNOWING, KNOWING_MEMORY, KNOWING_NUMBERS = "told-preference", "told-gru", View.NUMBERS.condition
MIRROR = "mirror"
RESPONSE, KNOWING_RESPONSE = "best-response", "told-best-response"
RESPONSES = RESPONSE, KNOWING_RESPONSE
# Rows that play the persons alone, where teams stand beside them: robots that met persons of the
# test side, or that are told numbers, which teams do not have.
OF_PERSONS = KNOWING_NUMBERS, MIRROR, *RESPONSES
GROUP_ORDER = (*GROUPS, OWN_FAMILY, TEAMS)
REFERENCES = (ZERO, RANDOM, SCRIPT)  # which stand in the folders of other rows
FIRST = (*REFERENCES, FIXED, PPO, BEST_OF_FOUR)  # methods follow
LAST = (KNOWING, KNOWING_MEMORY, KNOWING_NUMBERS, MIRROR, RESPONSE, KNOWING_RESPONSE)


@dataclasses.dataclass(frozen=True)
class LeagueRow:
    """Figures of one row with the partners of the side."""

    row: str
    robots: int
    partners: int
    mean: Estimate  # of groups' means, as M_test, if the side has groups
    share: Interval | None  # of (told best response - script); None if either is missing
    care: CareFigures  # empty for best responses
    seed_sd: float | None  # between robots, beside the luck of their episodes
    partner_sd: float | None
    pair_sd: float | None
    interaction_index: float | None  # see `evaluation.figures.metrics.variance.Spread`
    by_group: Mapping[str, Estimate]  # of the test side


@dataclasses.dataclass(frozen=True)
class League:
    """All rows of a task, in the order of a league."""

    context: Context
    side: str
    episodes: int
    episodes_per_pair: int
    nonfinite: int
    rows: tuple[LeagueRow, ...]
    by_partner: pl.DataFrame  # a row for each row and partner: `row`, `partner`, `mean`
    notes: tuple[str, ...]


def ordered(names: Iterable[str]) -> list[str]:
    """Return rows' names in the order of a league: fixed rows around methods sorted by name."""
    names = set(names)
    methods = sorted(names - {*FIRST, *LAST})
    return [name for name in (*FIRST, *methods, *LAST) if name in names]


def row_folders(folder: Path) -> dict[str, Path]:
    """Map row names to folders, in order; empty if `folder` is not a league.

    The folder of a finished evaluation is not a league, whatever else is in it.
    """
    found = {
        place.name
        for place in (() if (folder / tables.SUMMARY_FILE).is_file() else folder.glob("*"))
        if (place / tables.SUMMARY_FILE).is_file()
    }
    return {name: folder / name for name in ordered(found)}


def read_league(folder: Path) -> League:
    """Return the league of a folder of rows.

    Raises:
        FileNotFoundError: The folder has no row.
        ValueError: Rows are of several tasks, versions or partners.
    """
    folders = row_folders(folder)
    if not folders:
        raise FileNotFoundError(
            f"{folder} has no finished evaluation in a folder of its own; a league has one for "
            "each row"
        )
    read = [Evaluated.read(place, name) for name, place in folders.items()]
    teams = any(row.summary.split and row.summary.split.groups for row in read)
    compared = comparable(read, parts=OF_PERSONS if teams else RESPONSES, told=True)
    returns = {
        row.name: record.returns.evaluated_side
        for row, record in zip(read, compared.records, strict=True)
    }
    sides = {name: {"side": part.partners["side"][0]} for name, part in returns.items()}
    check_alike(sides, advice=ADVICE)
    shown = {**_references(folders, returns), **returns}
    means = {name: _means(name, part) for name, part in shown.items()}
    rows = tuple(_row(name, shown[name], means) for name in ordered(shown))
    first = read[0]
    return League(
        context=Context(**{f.name: getattr(first.summary, f.name) for f in _CONTEXT}),
        side=sides[first.name]["side"],
        episodes=sum(part.values.size for part in shown.values()),
        episodes_per_pair=first.summary.episodes_per_pair,
        nonfinite=sum(int(part.nonfinite.sum()) for part in shown.values()),
        rows=rows,
        by_partner=pl.concat([_by_partner(name, means[name]) for name in ordered(shown)]),
        notes=(*_notes(rows), *compared.notes),
    )


def league_table(league: League) -> pl.DataFrame:
    """Return a league as a table with a line for each row, for CSV."""
    lines = []
    groups = [g for g in GROUP_ORDER if any(g in row.by_group for row in league.rows)]
    wishes = list(dict.fromkeys(wish for row in league.rows for wish in row.care.adaptation))
    for row in league.rows:
        low, high = row.mean.mean_ci or (None, None)
        share_low, share_high = (row.share.value_ci if row.share else None) or (None, None)
        lines.append(
            {
                "row": row.row,
                "robots": row.robots,
                "partners": row.partners,
                "mean": row.mean.mean,
                "low": low,
                "high": high,
                **_group_columns(row, groups),
                "share": row.share.value if row.share else None,
                "share_low": share_low,
                "share_high": share_high,
                **_care_columns(row.care, wishes),
                "seed_sd": row.seed_sd,
                "partner_sd": row.partner_sd,
                "pair_sd": row.pair_sd,
                "interaction_index": row.interaction_index,
            }
        )
    texts, counts = {"row": pl.String}, dict.fromkeys(("robots", "partners"), pl.Int64)
    schema = {name: {**texts, **counts}.get(name, pl.Float64) for name in lines[0]}
    return pl.DataFrame(lines, schema=schema)


def columns_of(group: str) -> tuple[str, str, str]:
    """Return the names of a table's columns of a group: mean, and ends of its interval."""
    name = group.replace(" ", "_")
    return name, f"{name}_low", f"{name}_high"


def groups_of_table(table: pl.DataFrame) -> list[str]:
    """Return the groups of partners of which a table of `league_table` has columns, in order."""
    return [group for group in GROUP_ORDER if columns_of(group)[0] in table.columns]


def _group_columns(row: LeagueRow, groups: Iterable[str]) -> dict[str, float | None]:
    """Return a row's mean with each group of partners, and its interval; None if none played."""
    found: dict[str, float | None] = {}
    for group in groups:
        figure = row.by_group.get(group)
        values = (figure.mean, *(figure.mean_ci or (None, None))) if figure else (None,) * 3
        found |= dict(zip(columns_of(group), values, strict=True))
    return found


def _care_columns(care: CareFigures, wishes: Iterable[str]) -> dict[str, float | None]:
    """Return a row's figures of care, with the adaptation slope of each wish and its interval."""
    named = ("caring_success", "violations", "discomfort", "failed_persons")
    means = {name: figure.mean if (figure := getattr(care, name)) else None for name in named}
    kinds = {
        f"violations_{kind}": care.violations_by_kind[kind].mean
        if care.violations_by_kind
        else None
        for kind in VIOLATIONS[1:]
    }
    slopes: dict[str, float | None] = {}
    for wish in wishes:
        found = care.adaptation.get(wish)
        low, high = (found.slope.value_ci if found else None) or (None, None)
        value, within = (found.slope.value, found.within) if found else (None, None)
        names = f"slope_{wish}", f"slope_{wish}_low", f"slope_{wish}_high", f"within_{wish}"
        slopes |= dict(zip(names, (value, low, high, within), strict=True))
    return means | kinds | slopes


_CONTEXT = dataclasses.fields(Context)


def _references(folders: Mapping[str, Path], rows: Mapping[str, Returns]) -> dict[str, Returns]:
    """Return the returns of the reference robots, from the row with the most partners, by name."""
    having = [n for n, place in folders.items() if (place / tables.REFERENCES_FILE).is_file()]
    if not having:
        return {}
    widest = max(having, key=lambda name: rows[name].partners.height)
    table = tables.read_parquet(folders[widest] / tables.REFERENCES_FILE)
    partners = rows[widest].partners["partner"].to_list()
    found = {}
    for name in REFERENCES:
        own = table.filter((pl.col(COLUMN) == name) & pl.col("partner").is_in(partners))
        if own.height:
            found[name] = Record(own.drop(COLUMN), folders[widest]).returns
    return found


@dataclasses.dataclass(frozen=True)
class _Means:
    """Mean returns [S, P] with named partners; [1, P] for best responses."""

    scores: np.ndarray
    partners: list[str]

    def of(self, partners: Iterable[str]) -> np.ndarray:
        """Return the columns of these partners, in their order."""
        places = {partner: place for place, partner in enumerate(self.partners)}
        return self.scores[:, [places[partner] for partner in partners]]


def _means(name: str, returns: Returns) -> _Means:
    alone = name in RESPONSES
    scores = best_of_robots(returns.values)[None] if alone else returns.scores
    return _Means(scores, returns.partners["partner"].to_list())


def _row(name: str, returns: Returns, means: Mapping[str, _Means]) -> LeagueRow:
    alone = name in RESPONSES
    variance = None if alone else variance_components(returns.values)
    spread = variance.spread if variance else None
    scores = means[name].scores if alone else returns.values
    mean, by_group = _mean(scores, returns, common_starts=returns.common_starts and not alone)
    return LeagueRow(
        row=name,
        robots=returns.egos.height,
        partners=returns.partners.height,
        mean=mean,
        share=_share(means[name], means),
        care=CareFigures() if alone else care_figures(returns),
        seed_sd=spread.seeds if spread else None,
        partner_sd=spread.partners if spread else None,
        pair_sd=spread.pairs if spread else None,
        interaction_index=variance.interaction_index if variance else None,
        by_group=by_group,
    )


def _mean(
    scores: np.ndarray, returns: Returns, *, common_starts: bool
) -> tuple[Estimate, Mapping[str, Estimate]]:
    """Return the mean of scores [S, P] or [S, P, K], and that of each group of a test side."""
    groups = groups_of(returns.partners["partner_algorithm"].to_list())
    if groups is None or returns.partners["side"][0] != "test":
        return estimate(scores, common_starts=common_starts), {}
    return mean_of_groups(scores, groups, common_starts=common_starts)


def _share(own: _Means, means: Mapping[str, _Means]) -> Interval | None:
    """Return a row's share of the range from script to told best response."""
    if SCRIPT not in means or KNOWING_RESPONSE not in means:
        return None
    ends = means[SCRIPT], means[KNOWING_RESPONSE]
    common = [name for name in own.partners if all(name in end.partners for end in ends)]
    if not common:
        return None
    low, high = (end.of(common).mean(axis=0) for end in ends)
    return share_of_range(own.of(common), low, high)


def _by_partner(name: str, means: _Means) -> pl.DataFrame:
    content = {"partner": means.partners, "mean": means.scores.mean(axis=0)}
    return pl.DataFrame(content).select(pl.lit(name).alias("row"), "partner", "mean")


def of_persons(groups: Mapping[str, Collection[str]]) -> list[str]:
    """Return the rows that played persons alone, where others played teams too.

    Args:
        groups: The groups that each row played, by row.
    """
    if not any(TEAMS in played for played in groups.values()):
        return []
    return [row for row, played in groups.items() if TEAMS not in played]


def _notes(rows: Sequence[LeagueRow]) -> Iterable[str]:
    """Yield notes for readers on the rows."""
    few = [row.row for row in rows if row.row not in REFERENCES and row.robots < ENOUGH]
    if few:
        yield (
            f"fewer than {ENOUGH} robots: {', '.join(few)}; intervals of few seeds are too narrow"
        )
    if not any(row.share for row in rows):
        yield f"no share of the range: it takes the rows {SCRIPT} and {KNOWING_RESPONSE}"
    if alone := of_persons({row.row: row.by_group for row in rows}):
        yield (
            f"with persons alone: {', '.join(alone)}; teams have no numbers to tell, and robots "
            "that met the test side met its persons"
        )
    counts = {row.partners for row in rows}
    if len(counts) > 1:
        yield "rows with fewer partners are of a part of the side; shares are over those in common"
