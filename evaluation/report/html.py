"""Pieces of a page; every text from outside is escaped here."""

import base64
import io
import json
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import matplotlib
from matplotlib.figure import Figure

Cell = str | float | int | None
Heading = tuple[str, str]  # text, unit


def table(
    headings: Sequence[Heading],
    rows: Sequence[Sequence[Cell]],
    *,
    sortable: bool = False,
    digits: int = 1,
) -> str:
    """Return a table; numbers are rounded for reading and sorted as they are."""
    head = "".join(_heading(text, unit, rows, i) for i, (text, unit) in enumerate(headings))
    body = "".join(f"<tr>{''.join(_cell(value, digits) for value in row)}</tr>" for row in rows)
    kind = ' class="sortable"' if sortable else ""
    tall = " tall" if len(rows) > 16 else ""
    return f'<div class="table{tall}"><table{kind}><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def figures_table(named: Mapping[str, Mapping[str, Any] | None], what: str, digits: int = 1) -> str:
    """Return a table of estimates with their intervals, leaving out those that are None."""
    rows: list[list[Cell]] = [
        [
            name,
            *(figure[key] for key in ("mean", "iqm")),
            interval(figure, digits),
            figure["n"],
            figure["generalises_to"],
        ]
        for name, figure in named.items()
        if figure
    ]
    headings = [
        (what, ""),
        ("mean", ""),
        ("IQM", ""),
        ("95% of the IQM", ""),
        ("pairs", ""),
        ("speaks about new", ""),
    ]
    return table(headings, rows, digits=digits)


def tile(value: str, label: str, detail: str = "") -> str:
    """Return one headline figure."""
    below = f"<span>{escape(detail)}</span>" if detail else ""
    return f'<div class="tile"><span>{escape(label)}</span><b>{escape(value)}</b>{below}</div>'


def chips(texts: Sequence[str]) -> str:
    """Return short facts in a row."""
    return f'<ul class="chips">{"".join(f"<li>{escape(text)}</li>" for text in texts)}</ul>'


def notes(texts: Sequence[str]) -> str:
    """Return what a reader has to know of the figures."""
    return (
        f'<ul class="notes">{"".join(f"<li>{escape(text)}</li>" for text in texts)}</ul>'
        if texts
        else ""
    )


def image(figure: Figure, alt: str, kind: str = "svg") -> str:
    """Return a figure inside the page, as SVG or PNG."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "assistax-zoo"}):
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata)
    data = base64.b64encode(buffer.getvalue()).decode()
    mime = "svg+xml" if kind == "svg" else kind
    return f'<figure><img alt="{escape(alt)}" src="data:image/{mime};base64,{data}"></figure>'


def embedded(identity: str, value: Any) -> str:
    """Return JSON for the page's scripts; nothing in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" id="{identity}">{text}</script>'


def interval(figure: Mapping[str, Any], digits: int = 1) -> str:
    """Return the interval of an estimate's IQM in words."""
    ends = figure["iqm_ci"]
    return "–" if ends is None else " to ".join(f"{end:.{digits}f}" for end in ends)


def swatch(colour: str, text: str) -> str:
    """Return a name with its colour."""
    return f'<span><i class="swatch" style="background:{escape(colour)}"></i>{escape(text)}</span>'


def _heading(text: str, unit: str, rows: Sequence[Sequence[Cell]], column: int) -> str:
    kind = ' class="text"' if rows and isinstance(rows[0][column], str) else ""
    below = f'<br><span class="unit">{escape(unit)}</span>' if unit else ""
    return f'<th scope="col"{kind}>{escape(text)}{below}</th>'


def _cell(value: Cell, digits: int) -> str:
    if value is None:
        return "<td>–</td>"
    if isinstance(value, str):
        return f'<td class="text">{escape(value)}</td>'
    if isinstance(value, int):
        return f"<td>{value:,}</td>" if value >= 10_000 else f"<td>{value}</td>"
    return (
        f'<td data-value="{value!r}">{value:.{digits if abs(value) >= 1 else max(digits, 2)}f}</td>'
    )
