"""A board's rows as a reader asked for them: sorted, searched, and as CSV."""

import csv
import dataclasses
import io
import math
from collections.abc import Mapping

from assistax_board.pages.boards import Board, Played
from assistax_board.pages.site import NotFoundError, Site
from assistax_board.places.boards import BoardRow
from assistax_board.problems import Problem
from assistax_board.rules.caring import CARE

Row = tuple[BoardRow, Played]
Care = Mapping[str, Mapping[str, float]]  # figures of `mean_care` by row's name; of gentle tasks
AGAIN_SECONDS = 10  # after which who asked for a board that is being computed asks again
LONGEST = 80  # characters of a search; a method's name has no more
LOWER_IS_BETTER = ("failed_persons", "discomfort", "violations", "gap")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # how a text begins that spreadsheets compute


@dataclasses.dataclass(frozen=True)
class View:
    """Which rows of a board are shown, and in which order."""

    sort: str = ""
    search: str = ""
    show: str = ""  # "methods" leaves out the rows to measure by

    def of(self, board: Board, care: Care) -> tuple[Row, ...]:
        """Return the rows, the best first by `sort`, else as they stand on the board."""
        rows = board.methods if self.show == "methods" else board.rows
        text = self.search[:LONGEST].casefold()
        rows = tuple(row for row in rows if text in _names(row[1]).casefold())
        if self.sort not in SORTS | columns_of(care):
            return rows
        return tuple(sorted(rows, key=lambda row: self._rank(cells(row, care))))

    def _rank(self, values: Mapping[str, object]) -> tuple[bool, float | str]:
        value = values.get(self.sort)
        if isinstance(value, str):
            return False, value.casefold()
        if not isinstance(value, int | float) or not math.isfinite(value):
            return True, 0.0  # at the end, in the board's order
        return False, value if self.sort in LOWER_IS_BETTER else -value


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
        "m_test": standing.m_test.mean,
        "m_test_low": low,
        "m_test_high": high,
        "iqm": standing.m_test.iqm,
        "normalised": standing.normalised.mean if standing.normalised else None,
        **{name: fared.get(name) for name in columns_of(care)},
        "cvar_10": standing.cvar.value if standing.cvar else None,
        "worst_tenth": standing.worst_tenth.value,
        "gap": standing.fairness.gap.value if standing.fairness else None,
        "submission": played.newest.id,
    }


def board_csv(board: Board, care: Care) -> str:
    """Return a board as CSV, each row with the version that scored it.

    Names are texts of strangers: one that a spreadsheet would compute begins with an apostrophe.
    """
    out = io.StringIO()
    lines = [cells(row, care) | {"version": board.version} for row in board.rows]
    writer = csv.DictWriter(out, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _plain(value) for name, value in line.items()} for line in lines)
    return out.getvalue()


def old_version(site: Site, task: str, version: str) -> str | None:
    """Return the version named by a reader; None if it is the newest.

    Raises:
        NotFoundError: Nothing was scored under it.
    """
    versions = [id for id, _ in site.queries.versions(site.task(task))]
    if version and version not in versions:
        raise NotFoundError(f"The board of {task} never had such a version.")
    return None if version in ("", *versions[:1]) else version


def board_of(site: Site, task: str, version: str) -> Board:
    """Return the board of a task under a version that a reader named, or the newest.

    Raises:
        NotFoundError: Nothing was scored, or not under that version.
        Problem: It is being computed.
    """
    old = old_version(site, task, version)
    board = site.boards.of(task, old)
    if board is None and site.boards.is_behind(task, old):
        raise being_computed(task)
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
