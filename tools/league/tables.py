"""Tables of a league's page, from folders of rows and from an earlier page."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.bounded_reading import parse_json
from assistax_base.files import atomic_write
from assistax_envs.persons.rows import TEAMS, groups_of
from assistax_zoo.comparing import compare_named
from evaluation.figures.contrasts import ContrastsFile
from evaluation.figures.league import League, league_table, ordered, read_league, row_folders
from evaluation.figures.metrics.inference import holm
from evaluation.record import tables
from evaluation.record.record import Record
from evaluation.validation import CURVE
from tools.league.figures import failures
from tools.league.making import RUNS, TRAINING_SIDE
from tools.league.parts import RECORD, TRAINED
from tools.league.rows import rows

# Kinds of tables: a file for each task, but one for all tasks of the last two.
LEAGUE, PARTNERS, TRAINING, VALIDATION = "league", "partners", TRAINING_SIDE, "validation"
RECORDS, CONTRASTS = "rows", "contrasts"
_KEY = ("task", "method", "baseline", "metric")


@dataclasses.dataclass(frozen=True)
class Tables:
    """Tables of a page. The first four are by task, and have a column `row`."""

    league: dict[str, pl.DataFrame]  # of `league_table`
    partners: dict[str, pl.DataFrame]  # each row's mean with each partner, and the partner's family
    training: dict[str, pl.DataFrame]  # as `league`, with partners of the training side
    validation: dict[str, pl.DataFrame]  # learning curves: `seed`, `steps`, `return`
    records: pl.DataFrame  # how each row was made
    contrasts: pl.DataFrame | None = None

    @property
    def by_task(self) -> dict[str, dict[str, pl.DataFrame]]:
        """Tables of each task, by kind."""
        known = (self.league, self.partners, self.training, self.validation)
        return dict(zip((LEAGUE, PARTNERS, TRAINING, VALIDATION), known, strict=True))

    def write(self, out: Path) -> list[Path]:
        """Write the tables as CSV; return their paths."""
        written = []
        for what, of_task in self.by_task.items():
            for task, table in of_task.items():
                shown = failures(table) if what == PARTNERS else table
                written.append(_csv(shown, out / f"{task}-{what}.csv"))
        written.append(_csv(self.records, out / f"{RECORDS}.csv"))
        if self.contrasts is not None:
            written.append(_csv(self.contrasts, out / f"{CONTRASTS}.csv", 6))
        return written


def of_folders(folder: Path, contrasts: Path | None) -> Tables:
    """Return the tables of the rows in a folder, which has a folder for each task.

    Raises:
        FileNotFoundError: The folder has no row of any task.
    """
    places = sorted(place for place in folder.glob("*") if row_folders(place))
    if not places:
        raise FileNotFoundError(f"{folder} has no folder of a task with rows; make some with `row`")
    leagues = {place: read_league(place) for place in places}
    sides = {place: read_league(place / TRAINING_SIDE) for place in places if _trained(place)}
    tested = None
    if contrasts is not None:
        methods = [row for place in places for row in row_folders(place).values()]
        tested = _contrast_table(compare_named(contrasts, methods).contrasts)
    return Tables(
        league={league.context.task: league_table(league) for league in leagues.values()},
        partners={
            league.context.task: _with_families(league, place) for place, league in leagues.items()
        },
        training={league.context.task: league_table(league) for league in sides.values()},
        validation={
            league.context.task: curves
            for place, league in leagues.items()
            if (curves := _curves(place)) is not None
        },
        records=pl.DataFrame(_records(leagues), infer_schema_length=None),
        contrasts=tested,
    )


def read_tables(folder: Path) -> Tables:
    """Return the tables that an earlier page wrote.

    Raises:
        FileNotFoundError: The folder has no such tables.
    """
    found: dict[str, dict[str, pl.DataFrame]] = {}
    for what in (LEAGUE, PARTNERS, TRAINING, VALIDATION):
        paths = sorted(folder.glob(f"*-{what}.csv"))
        found[what] = {path.name.removesuffix(f"-{what}.csv"): _read(path) for path in paths}
    known = found[PARTNERS].items()  # shares are of the best row, which a new one may be
    found[PARTNERS] = {task: t.select("row", "partner", "mean", "family") for task, t in known}
    if not found[LEAGUE]:
        raise FileNotFoundError(f"{folder} has no tables of a league's page; name its --out")
    path = folder / f"{CONTRASTS}.csv"
    tested = _read(path) if path.is_file() else None
    return Tables(*found.values(), _read(folder / f"{RECORDS}.csv"), tested)


def beside(new: Tables, old: Tables) -> Tables:
    """Return new tables, with the older rows that they lack.

    A task that was since played on another split has its new rows alone.
    """
    before = splits_of(old.records)
    moved = {
        task for task, split in splits_of(new.records).items() if before.get(task, split) != split
    }
    joined: dict[str, dict[str, pl.DataFrame]] = {}
    for what, tasks in new.by_task.items():
        kept = {name: t for name, t in old.by_task[what].items() if name not in moved}
        joined[what] = {
            task: _in_order(_joined(tasks.get(task), kept.get(task), ["row"]))
            for task in sorted({*tasks, *kept})
        }
    stays = ~pl.col("task").is_in(sorted(moved))
    records = _joined(new.records, old.records.filter(stays), ["task", "row"])
    tested = new.contrasts
    if tested is not None and old.contrasts is not None:
        tested = _joined(tested, old.contrasts.filter(stays), list(_KEY))
    return Tables(*joined.values(), _in_order(records, "task"), tested)


def corrected(shown: Tables, file: ContrastsFile) -> pl.DataFrame | None:
    """Return contrasts in the file's order, with Holm's p over all contrasts of the file.

    Contrasts that were not played, or on another split, or with fewer seeds than named, count as p
    = 1.
    """
    if shown.contrasts is None:
        return None
    wanted = {_of(dict(contrast)): contrast for contrast in file.contrasts}
    places = {key: place for place, key in enumerate(wanted)}
    splits, lines = splits_of(shown.records), list(shown.contrasts.iter_rows(named=True))
    for line in lines:
        contrast = wanted.get(_of(line))
        split = splits.get(line["task"])
        line["named"] = (
            contrast is not None
            and line["seeds"] >= contrast.seeds
            and split in (None, contrast.split)
        )
    lines.sort(key=lambda line: places.get(_of(line), len(places)))
    full = {_of(line): line["p"] for line in lines if line["named"]}
    by_holm = dict(zip(places, holm([full.get(key, 1.0) for key in places]), strict=True))
    for line in lines:
        p = by_holm[_of(line)] if line["named"] else None
        line |= {"p_holm": p, "found": None if p is None else p <= file.alpha}
    return pl.DataFrame(lines, schema=shown.contrasts.schema)


def splits_of(records: pl.DataFrame, which: str = "split") -> dict[str, str]:
    """Return the split of each task, if one of its rows names it.

    Args:
        records: How rows were made.
        which: "split", that of the league, or "training_split", that robots learned with.
    """
    return dict(records.select("task", which).drop_nulls().iter_rows())


def _of(line: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the key of a contrast's line."""
    return tuple(line[name] for name in _KEY)


def _trained(place: Path) -> bool:
    """Return whether a folder has rows with the training side."""
    return bool(row_folders(place / TRAINING_SIDE))


def _with_families(league: League, place: Path) -> pl.DataFrame:
    """Return each row's mean with each partner, and the partner's family.

    It is its algorithm, but "teams" of all teams beside persons.
    """
    folders = row_folders(place).values()
    known = [Record.read(folder).table.select("partner", "partner_algorithm") for folder in folders]
    families = pl.concat(known).unique().rename({"partner_algorithm": "family"})
    if groups := groups_of(families["family"].to_list()):
        family = pl.when(pl.Series(groups) == TEAMS).then(pl.lit(TEAMS)).otherwise("family")
        families = families.with_columns(family=family)
    return league.by_partner.join(families, on="partner", how="left", maintain_order="left")


def _curves(task: Path) -> pl.DataFrame | None:
    """Return the learning curves of a task's rows, concatenated; None if no row has a curve."""
    found = [
        tables.read_parquet(path).select(pl.lit(row).alias("row"), pl.all())
        for row in ordered(place.name for place in (task / RUNS).glob("*"))
        if (path := task / RUNS / row / TRAINED / CURVE).is_file()
    ]
    return pl.concat(found) if found else None


def _records(leagues: Mapping[Path, League]) -> list[dict[str, Any]]:
    """Return the records of how rows were made."""
    shown = ("task", "row", "robots", "steps", "total_steps", "device", "device_minutes_in_all")
    found = []
    for place, league in leagues.items():
        for name in row_folders(place):
            path = place / RUNS / name / RECORD
            record = parse_json(path.read_text(encoding="utf-8")) if path.is_file() else {}
            known = {key: record.get(key) for key in (*shown, "contrasts")}
            known |= {"row": name, "task": league.context.task, "made": name in rows()}
            split = record.get("split")
            learned = record.get("training_split", split)
            found.append({**known, "split": split, "training_split": learned})
    return found


def _contrast_table(figures: tuple[Any, ...]) -> pl.DataFrame:
    """Return the table of compared contrasts."""
    lines = []
    for figure in figures:
        low, high = figure.difference.mean_ci or (None, None)
        lines.append(
            {
                "task": figure.task,
                "method": figure.method,
                "baseline": figure.baseline,
                "metric": figure.metric,
                "named": figure.named,
                "seeds": min(figure.seeds),
                "partners": figure.partners,
                "mean": figure.difference.mean,
                "low": low,
                "high": high,
                "p": figure.p,
                "p_holm": figure.p_holm,
                "found": figure.found,
                "detectable": figure.detectable,
                "detectable_holm": figure.detectable_holm,
            }
        )
    types = {"p_holm": pl.Float64, "found": pl.Boolean, "low": pl.Float64, "high": pl.Float64}
    return pl.DataFrame(lines, schema_overrides=types if lines else None)


def _joined(
    new: pl.DataFrame | None,
    old: pl.DataFrame | None,
    keys: list[str],
) -> pl.DataFrame:
    """Return a new table's lines, and an old one's lines of other keys, with the new columns."""
    if new is None or old is None:
        table = new if old is None else old
        assert table is not None
        return table
    kept = old.join(new, on=keys, how="anti").select(
        pl.col(name).cast(new.schema[name]) if name in old.columns else pl.lit(None).alias(name)
        for name in new.columns
    )
    return pl.concat([new, kept], how="vertical_relaxed")


def _in_order(table: pl.DataFrame, *first: str) -> pl.DataFrame:
    """Return a table sorted by some columns, and then by row in the order of a league."""
    places = {name: place for place, name in enumerate(ordered(table["row"].to_list()))}
    order = pl.col("row").replace_strict(places, return_dtype=pl.Int64)
    return table.sort(*first, order, maintain_order=True)


def _read(path: Path) -> pl.DataFrame:
    """Return a CSV file's table."""
    return pl.read_csv(path.read_bytes(), infer_schema_length=None)


def _csv(table: pl.DataFrame, path: Path, digits: int = 3) -> Path:
    """Write a table as CSV; return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    atomic_write(path, table.write_csv(float_precision=digits).encode())
    return path
