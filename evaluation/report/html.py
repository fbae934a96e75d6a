"""Pieces of a page. What is not `Html` is text, and is escaped wherever it enters one.

So a piece that forgets to be careful shows its tags to the reader, and runs nothing.
"""

import base64
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import matplotlib
from matplotlib.figure import Figure

Cell = str | float | int | None
Heading = tuple[str, str]  # text, unit


class Html(str):
    """Text that is HTML already."""


def fill(template: str, /, *items: object, **values: object) -> Html:
    """Return a template, which is HTML, with text and HTML in the places of its braces."""
    given = [_safe(item) for item in items]
    return Html(template.format(*given, **{name: _safe(item) for name, item in values.items()}))


def join(pieces: Iterable[object], between: str = "") -> Html:
    """Return pieces one after the other."""
    return Html(between.join(_safe(piece) for piece in pieces))


def _safe(value: object) -> str:
    return value if isinstance(value, Html) else escape(str(value))


def table(
    headings: Sequence[Heading],
    rows: Sequence[Sequence[Cell]],
    *,
    sortable: bool = False,
    digits: int = 1,
) -> Html:
    """Return a table; numbers are rounded for reading and sorted as they are."""
    head = join(_heading(text, unit, rows, i) for i, (text, unit) in enumerate(headings))
    body = join(fill("<tr>{}</tr>", join(_cell(value, digits) for value in row)) for row in rows)
    return fill(
        '<div class="table{tall}"><table{kind}><thead><tr>{head}</tr></thead>'
        "<tbody>{body}</tbody></table></div>",
        tall=" tall" if len(rows) > 16 else "",
        kind=Html(' class="sortable"') if sortable else "",
        head=head,
        body=body,
    )


def figures_table(
    named: Mapping[str, Mapping[str, Any] | None], what: str, digits: int = 1
) -> Html:
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


def tile(value: str, label: str, detail: str = "") -> Html:
    """Return one headline figure."""
    below = fill("<span>{}</span>", detail) if detail else ""
    return fill('<div class="tile"><span>{}</span><b>{}</b>{}</div>', label, value, below)


def tiles(pieces: Sequence[Html]) -> Html:
    """Return headline figures in a row."""
    return fill('<div class="tiles">{}</div>', join(pieces))


def chips(texts: Sequence[str]) -> Html:
    """Return short facts in a row."""
    return fill('<ul class="chips">{}</ul>', join(fill("<li>{}</li>", text) for text in texts))


def notes(texts: Sequence[str]) -> Html:
    """Return what a reader has to know of the figures."""
    listed = join(fill("<li>{}</li>", text) for text in texts)
    return fill('<ul class="notes">{}</ul>', listed) if texts else Html("")


def image(figure: Figure, alt: str, kind: str = "svg") -> Html:
    """Return a figure inside the page, as SVG or PNG."""
    buffer = io.BytesIO()
    metadata = {"Date": None} if kind == "svg" else {"Software": None}
    with matplotlib.rc_context({"svg.hashsalt": "assistax-zoo"}):
        figure.savefig(buffer, format=kind, dpi=150, metadata=metadata)
    data = base64.b64encode(buffer.getvalue()).decode()
    mime = "svg+xml" if kind == "svg" else kind
    return fill('<figure><img alt="{}" src="data:image/{};base64,{}"></figure>', alt, mime, data)


def embedded(identity: str, value: Any) -> Html:
    """Return JSON for the page's scripts; nothing in it can end the element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return fill('<script type="application/json" id="{}">{}</script>', identity, Html(text))


def interval(figure: Mapping[str, Any], digits: int = 1) -> str:
    """Return the interval of an estimate's IQM in words."""
    ends = figure["iqm_ci"]
    return "–" if ends is None else " to ".join(f"{end:.{digits}f}" for end in ends)


def swatch(colour: str, text: str) -> Html:
    """Return a name with its colour."""
    return fill('<span><i class="swatch" style="background:{}"></i>{}</span>', colour, text)


def _heading(text: str, unit: str, rows: Sequence[Sequence[Cell]], column: int) -> Html:
    kind = ' class="text"' if rows and isinstance(rows[0][column], str) else ""
    below = fill('<br><span class="unit">{}</span>', unit) if unit else ""
    return fill('<th scope="col"{}>{}{}</th>', Html(kind), text, below)


def _cell(value: Cell, digits: int) -> Html:
    if value is None:
        return Html("<td>–</td>")
    if isinstance(value, str):
        return fill('<td class="text">{}</td>', value)
    if isinstance(value, int):
        return fill("<td>{}</td>", f"{value:,}" if value >= 10_000 else value)
    shown = f"{value:.{digits if abs(value) >= 1 else max(digits, 2)}f}"
    return fill('<td data-value="{}">{}</td>', repr(value), shown)
