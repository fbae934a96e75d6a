"""Templates and static files.

Whatever stands in a template is escaped: autoescape is on for every one, and none marks a text as
safe. A misspelt name is an error and not an empty place.
"""

import functools
import hashlib
import math
import time
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import Any

import jinja2

from assistax_board.pages.cache import Page, pack
from assistax_board.store.queries import STATEMENT

_PACKAGE = "assistax_board.pages"
_MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
PLAYER = ("three.min.js", "player_parts.js", "player_scene.js", "player.js")  # in this order
_OF_REPORTS = ("matrix.js", "player.css", *PLAYER)


def render(template: str, **values: Any) -> str:
    """Return a page."""
    return _environment().get_template(template).render(**values)


@functools.cache
def static_files() -> dict[str, Page]:
    """Return the files of /static, by "name" with the hash of its content before the ending."""
    folder = resources.files(_PACKAGE) / "static"
    # The cross-play's viewer and the player of episodes are those of reports.
    of_reports = resources.files("evaluation.report") / "assets"
    sources = [*folder.iterdir(), *(of_reports / name for name in _OF_REPORTS)]
    files = {}
    for source in sources:
        stem, dot, ending = source.name.rpartition(".")
        if f".{ending}" in _MEDIA_TYPES:
            body = source.read_bytes()
            digest = hashlib.sha256(body).hexdigest()[:12]
            files[f"{stem}.{digest}.{ending}"] = pack(body, _MEDIA_TYPES[dot + ending])
    return files


@functools.cache
def static_address(name: str) -> str:
    """Return the address of a static file: a new one whenever its content changes."""
    stem, _, ending = name.rpartition(".")
    for hashed in static_files():
        if hashed.startswith(f"{stem}.") and hashed.endswith(f".{ending}"):
            return f"/static/{hashed}"
    raise FileNotFoundError(f"there is no static file {name}")


@functools.cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(_PACKAGE),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    names: Any = environment.globals
    names.update(static=static_address, statement=STATEMENT, player=PLAYER)
    for filter in (figure, interval, percent, day, moment, duration, countdown, words):
        environment.filters[filter.__name__] = filter
    environment.filters["rows"] = table_rows
    return environment


def figure(value: float | None) -> str:
    """Round a return for reading: 987.2, 0.31, or a dash if there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value:,.1f}" if abs(value) >= 10 else f"{value:.2f}"


def interval(ends: Sequence[float] | None) -> str:
    """Write an interval, or nothing if there is none."""
    return "" if ends is None else f"{figure(ends[0])} to {figure(ends[1])}"


def percent(share: float | None) -> str:
    """Write a share as a percentage."""
    return "–" if share is None else f"{share:.0%}"


def day(at: float | None) -> str:
    """Write a time as its date."""
    return "–" if at is None else time.strftime("%Y-%m-%d", time.gmtime(at))


def moment(at: float | None) -> str:
    """Write a time to the minute."""
    return "–" if at is None else time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(at))


def duration(seconds: float | None) -> str:
    """Write how long something takes, in words that promise no more than is known."""
    if seconds is None:
        return "unknown"
    if seconds < 90:
        return "about a minute"
    if seconds < 5400:
        return f"about {round(seconds / 60)} minutes"
    return f"about {round(seconds / 3600)} hours"


def countdown(seconds: float) -> str:
    """Write how long it is until a date."""
    minutes = int(seconds // 60)
    if minutes < 1:
        return "in less than a minute" if seconds > 0 else "now"
    days, hours, rest = minutes // 1440, minutes // 60 % 24, minutes % 60
    return f"in {days} days {hours} hours" if days else f"in {hours} hours {rest} minutes"


def words(name: str) -> str:
    """Write an id such as first_contact as words."""
    return name.replace("_", " ")


def table_rows(values: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return nested facts as rows of name and value, for a table."""
    rows = []
    for name, value in values.items():
        if isinstance(value, Mapping):
            rows += [(f"{name}.{key}", text) for key, text in table_rows(value)]
        elif value is not None:
            rows.append(
                (name, ", ".join(map(str, value)) if isinstance(value, list) else str(value))
            )
    return rows
