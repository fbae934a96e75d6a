"""A board's rows as a reader asked for them: sorted, searched, and as CSV."""

import csv
import dataclasses
import io
import math
import re
import urllib.parse
from collections.abc import Mapping, Sequence

from assistax_board.pages.boards import Board, Care, Played
from assistax_board.pages.site import NotFoundError, Site
from assistax_board.places.boards import BoardRow
from assistax_board.places.caring import CARE
from assistax_board.problems import Problem

Row = tuple[BoardRow, Played]
AGAIN_SECONDS = 10  # after which who asked for a board that is being computed asks again
LAST = 10_000  # page that a reader may ask for
ROWS, FEW = 50, 10  # of a page, and of the single robots below the entries
LONGEST = 80  # characters of a search; a method's name has no more
LOWER_IS_BETTER = ("failed_persons", "discomfort", "violations", "gap")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # how a text begins that spreadsheets compute


@dataclasses.dataclass(frozen=True)
class View:
    """Which rows of a board are shown, and in which order."""

    sort: str = ""
    search: str = ""
    show: str = ""  # "methods" leaves out the rows to measure by, "singles" shows single robots
    page: int = 1

    def of(self, board: Board) -> "Listed":
        """Return the page of the chosen list."""
        if self.show == "singles":
            return self._listed(board, board.singles)
        entries = (row for row in board.rows if row[1].is_entry or row[1].is_reference)
        return self._listed(board, board.methods if self.show == "methods" else tuple(entries))

    def singles(self, board: Board) -> "Listed":
        """Return the first of the single robots, which stand below the entries."""
        view = dataclasses.replace(self, show="singles", page=1)
        rows = () if self.show or self.page > 1 else board.singles
        return view._listed(board, rows, FEW)

    def _listed(self, board: Board, rows: Sequence[Row], size: int = ROWS) -> "Listed":
        """Return a page of rows, the best first by `sort`, else as they stand on the board."""
        text = self.search[:LONGEST].casefold()
        found = [row for row in rows if text in _names(row[1]).casefold()]
        if self.sort in SORTS | groups_of(board) | columns_of(board.care):
            found.sort(key=lambda row: self._rank(cells(row, board.care)))
        pages = max(1, -(-len(found) // size))
        page = min(max(1, self.page), pages)
        start = (page - 1) * size
        shown = tuple(found[start : start + size])
        return Listed(self, board.task, shown, page, pages, start + 1, len(found), len(rows))

    def _rank(self, values: Mapping[str, object]) -> tuple[bool, float | str]:
        value = values.get(self.sort)
        if isinstance(value, str):
            return False, value.casefold()
        if not isinstance(value, int | float) or not math.isfinite(value):
            return True, 0.0  # at the end, in the board's order
        return False, value if self.sort in LOWER_IS_BETTER else -value


@dataclasses.dataclass(frozen=True)
class Listed:
    """A page of a list of rows."""

    view: View
    task: str
    rows: tuple[Row, ...]
    page: int
    pages: int
    first: int  # number of its first row, from 1
    count: int  # rows that match
    all: int  # rows of the list

    @property
    def last(self) -> int:
        """Number of its last row."""
        return self.first + len(self.rows) - 1

    def address(self, page: int) -> str:
        """Return the address of another page of the list."""
        view = dataclasses.asdict(self.view) | {"page": page if page > 1 else ""}
        asked = urllib.parse.urlencode({name: value for name, value in view.items() if value})
        return f"/tasks/{self.task}?{asked}" if asked else f"/tasks/{self.task}"


SORTS = {
    "m_test": "M_test",
    "iqm": "IQM",
    "normalised": "normalised return",
    "cvar_10": "CVaR 10%",
    "worst_tenth": "worst tenth",
    "gap": "gap over disabilities",
    "seeds": "number of seeds",
    "method": "name",
    "submitter": "lab",
}


def columns_of(care: Care) -> dict[str, str]:
    """Return the columns of care that some row has, and their names for readers."""
    names = {name for figures in care.values() for name in figures}
    slopes = {name: name.replace("_", " ") for name in sorted(names - {*CARE})}
    return {name: text for name, text in CARE.items() if name in names} | slopes


def groups_of(board: Board | None) -> dict[str, str]:
    """Return the columns of the groups of partners, which M_test counts alike, and their names."""
    groups = board.rows[0][0].by_group if board else {}
    return {column_of(name): name for name in sorted(groups)}


def column_of(group: str) -> str:
    """Return the name of a group's column."""
    return "m_" + re.sub("[^a-z0-9]+", "_", group.lower())


def has_settings(board: Board | None) -> bool:
    """Return whether partners have several disability settings, so that a gap says something."""
    return board is not None and len({partner.disability for partner in board.partners}) > 1


def cells(row: Row, care: Care) -> dict[str, str | float | None]:
    """Return a row as the CSV's columns name it."""
    standing, played = row
    fared = care.get(standing.name, {})
    low, high = standing.m_test.mean_ci or (None, None)
    return {
        "place": standing.place,
        "lowest": standing.lowest,
        "method": played.newest.method,
        "submitter": played.newest.submitter,
        "reference": int(played.is_reference),
        "seeds": len(played.submissions),
        "declared": played.newest.declared,
        "m_test": standing.m_test.mean,
        "m_test_low": low,
        "m_test_high": high,
        **{column_of(name): found.mean for name, found in sorted(standing.by_group.items())},
        "iqm": standing.m_test.iqm,
        "normalised": standing.normalised.mean if standing.normalised else None,
        **{name: fared.get(name) for name in columns_of(care)},
        "cvar_10": standing.cvar.value if standing.cvar else None,
        "worst_tenth": standing.worst_tenth.value,
        "gap": standing.fairness.gap.value if standing.fairness else None,
        **{name: played.links.get(name) for name in ("paper", "code")},
        "submission": played.newest.id,
    }


def board_csv(board: Board) -> str:
    """Return a board as CSV, each row with the version that scored it.

    Names are texts of strangers: one that a spreadsheet would compute begins with an apostrophe.
    """
    out = io.StringIO()
    lines = [cells(row, board.care) | {"version": board.version} for row in board.rows]
    writer = csv.DictWriter(out, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _plain(value) for name, value in line.items()} for line in lines)
    return out.getvalue()


def old_version(site: Site, task: str, version: str) -> str | None:
    """Return the version named by a reader; None if it is the one that is served.

    Raises:
        NotFoundError: Nothing was scored under it.
    """
    versions = [id for id, _ in site.queries.versions(site.task(task))]
    if version and version not in versions:
        raise NotFoundError(f"The board of {task} never had such a version.")
    return None if version in ("", *versions[:1]) else version


def board_of(site: Site, task: str, version: str) -> Board:
    """Return the board of a task under a version that a reader named, or the one served.

    Raises:
        NotFoundError: Nothing was scored, or not under that version.
        Problem: It is being computed.
    """
    old = old_version(site, task, version)
    board = site.boards.of(task, old)
    if board is None and site.boards.is_behind(task, old):
        raise being_computed(task)
    board = board or site.boards.of(task, old)  # it may have been done between the two questions
    if board is None:
        raise NotFoundError(f"The board of {task} is empty: no method was scored yet.")
    return board


def being_computed(task: str) -> Problem:
    """Return the placeholder page shown while a board is computed."""
    message = f"the board of {task} is being computed; ask again in {AGAIN_SECONDS} seconds"
    return Problem("unavailable", message, retry_after=AGAIN_SECONDS)


def _plain(value: str | float | None) -> str | float | None:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def _names(played: Played) -> str:
    return f"{played.newest.method} {played.newest.submitter}"
