"""Sources of the numbers that persons are made of: docs/tables/person_sources.csv.

    python -m tools.person_sources          # compare the table with the tasks' numbers
    python -m tools.person_sources write    # after a number changed

A number has one row, whichever tasks have it. The tasks say what it is, its range and its source.
The table adds how the source was read, and a note: `write` keeps both. Exit code 1 if they differ.
"""

import csv
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from assistax_envs.persons.rows import PARAMETERS
from assistax_envs.registered import OURS
from assistax_envs.tasks.person import Parameter

TABLE = Path(__file__).parents[1] / "docs" / "tables" / "person_sources.csv"
# How a source was read: a figure in it, its abstract or first page, from memory, or none was.
HOW = ("printed table", "abstract", "memory", "design")
READ = ("how it was read", "note")  # columns that the table alone has
Row = dict[str, str]


def rows_of(parameters: Mapping[str, Sequence[Parameter]], known: Sequence[Row] = ()) -> list[Row]:
    """Return the rows of the numbers of tasks, in the order in which tasks have them.

    Args:
        parameters: Numbers by task.
        known: Rows whose last two columns are kept.
    """
    tasks: dict[Parameter, list[str]] = {}
    for task, numbers in parameters.items():
        for number in numbers:
            tasks.setdefault(number, []).append(task)
    read = {_key(row): {name: row.get(name) or "" for name in READ} for row in known}
    rows = [_row(number, where) for number, where in tasks.items()]
    return [row | read.get(_key(row), dict.fromkeys(READ, "")) for row in rows]


def find_problems(parameters: Mapping[str, Sequence[Parameter]], table: Sequence[Row]) -> list[str]:
    """Return messages for rows that are missing, too many, or differ, and for unread sources."""
    known = {_key(row): row for row in table}
    problems = []
    for row in rows_of(parameters, table):
        label, old = f"{row['name']} of {row['tasks']}", known.pop(_key(row), {})
        differing = [name for name in row if row[name] != old.get(name)]
        if differing:
            problems.append(f"{label}: another {', '.join(differing)} than the tasks' numbers have")
        said = next((how for how in ("memory", "design") if row["source"].startswith(how)), None)
        if row[READ[0]] not in ((said,) if said else HOW):
            allowed = said or ", ".join(HOW)
            problems.append(f"{label}: read as {row[READ[0]]!r}; allowed is {allowed}")
    more = [f"{row['name']} of {row['tasks']}: no person has it" for row in known.values()]
    return problems + more


def read(path: Path = TABLE) -> list[Row]:
    """Return the rows of the table."""
    return list(csv.DictReader(path.read_text(encoding="utf-8").splitlines()))


def _key(row: Row) -> tuple[str, str]:
    return row["tasks"], row["name"]


def _row(number: Parameter, tasks: Sequence[str]) -> Row:
    """Return what tasks say of a number."""
    distribution = "uniform"
    if number.median is not None:
        distribution = f"log-normal, {number.median:g}, {number.sigma:g}"
    return {
        "name": number.name,
        "tasks": "all" if set(tasks) == set(OURS) else " ".join(tasks),
        "what it is": number.meaning,
        "unit": number.unit,
        "low": f"{number.low:g}",
        "high": f"{number.high:g}",
        "distribution": distribution + (f"; {number.none:.0%} have none" if number.none else ""),
        "source": number.source,
    }


def main() -> int:
    """Write the table, or print how it differs and return 1."""
    ours = {task: PARAMETERS[task] for task in OURS}
    if sys.argv[1:] == ["write"]:
        rows = rows_of(ours, read() if TABLE.exists() else ())
        with TABLE.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, rows[0], lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
    problems = find_problems(ours, read())
    print("\n".join(problems) or f"{len(read())} numbers, as the tasks have them")
    return bool(problems)


if __name__ == "__main__":
    raise SystemExit(main())
