"""Pieces of the Markdown page."""

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

MISSING = "not measured yet"
Table = tuple[Sequence[str], Sequence[Sequence[object]]]  # headings and rows


def table(
    headings: Sequence[str], rows: Sequence[Sequence[object]], numbers: Sequence[int] = ()
) -> str:
    """Return a table; the columns `numbers` are aligned to the right."""
    rule = ["---:" if i in numbers else "---" for i in range(len(headings))]
    lines = [headings, rule, *([str(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def figure(
    value: Mapping[str, Any] | None, digits: int = 1, key: str = "iqm", *, percent: bool = False
) -> str:
    """Return the point of the name `key` with its 95% interval: `939.5 [934.0, 958.0]`."""
    if value is None:
        return MISSING
    form = f".{digits}%" if percent else f",.{digits}f"
    interval = value.get(f"{key}_ci")
    ends = "" if interval is None else f" [{interval[0]:{form}}, {interval[1]:{form}}]"
    return f"{value[key]:{form}}{ends}"


def spoken(name: str) -> str:
    """Return a task or setting as it is read: "bed bath"."""
    return name.replace("_", " ")


def image(path: str, text: str) -> str:
    """Return a picture as wide as the page."""
    return f'<img src="{path}" alt="{text}" width="100%">'


def csv_table(headings: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([headings, *rows])
    return out.getvalue()


def csv_of(found: Table | None, heading: str, name: str) -> str:
    """Return a table as CSV with one column in front; empty for None.

    Args:
        found: Headings and rows.
        heading: Of the column before them.
        name: Its value in every row.
    """
    if found is None:
        return ""
    headings, rows = found
    return csv_table([heading, *headings], ([name, *row] for row in rows)).replace("`", "")


def code(text: str) -> str:
    """Return a block of commands."""
    return f"```console\n{text}\n```"
