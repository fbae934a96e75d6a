"""The board of a closed season: every lab's entries and the references, on panel B."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import polars as pl

from assistax_board.pages.behind import Behind
from assistax_board.pages.boards import Played, bounds_of
from assistax_board.places.boards import BoardRow, Method, Panel, board_rows
from assistax_board.rules.caring import care_of, mean_care
from assistax_board.store.queries import Queries
from assistax_board.store.shown import Season, Submission
from evaluation.figures.metrics import SEED_SDS

PanelB = Callable[[str], Sequence[tuple[str, pl.DataFrame]]]  # season -> submissions' episodes


@dataclasses.dataclass(frozen=True)
class Entry(Played):
    """A method on panel B: its seeds, how often they succeeded, and how people fared."""

    success: float
    care: Mapping[str, float]  # of gentle tasks, see `mean_care`; else empty


class SeasonBoards:
    """The boards of closed seasons; each is computed once, behind its readers."""

    def __init__(self, queries: Queries, panel_b: PanelB) -> None:
        self._queries, self._panel_b = queries, panel_b
        self._boards: Behind[tuple[tuple[BoardRow, Entry], ...]] = Behind()

    def of(self, season: Season) -> tuple[tuple[BoardRow, Entry], ...]:
        """Return the rows of a season, the highest first; empty until it is closed."""
        if season.state != "closed":
            return ()
        scores = self._queries.scores(season=season.id, panel="B")
        key = tuple(score.submission for score in scores)  # one may be disqualified later
        return self._boards.value(season.id, key, lambda: self._rows(season)) or ()

    def is_behind(self, season: Season) -> bool:
        """Return whether the board of a closed season is being computed."""
        return self._boards.is_behind(season.id)

    def _rows(self, season: Season) -> tuple[tuple[BoardRow, Entry], ...]:
        entries = self._entries(season)
        if not entries:
            return ()
        [*names], [*settings] = zip(*_partners(self._panel_b(season.id)[0][1]), strict=True)
        references = {entry.newest.method: entry.returns for entry in entries if entry.is_reference}
        panel = Panel(
            tuple(settings), bounds_of(names, references, None), SEED_SDS.get(season.task)
        )
        by_name = {entry.newest.id: entry for entry in entries}
        methods = [
            Method(id, entry.returns, not entry.is_reference) for id, entry in by_name.items()
        ]
        return tuple((row, by_name[row.name]) for row in board_rows(methods, panel))

    def _entries(self, season: Season) -> list[Entry]:
        groups: dict[tuple[str, str], list[tuple[Submission, pl.DataFrame]]] = {}
        for id, table in self._panel_b(season.id):
            if submission := self._queries.submission(id):
                key = submission.submitter, submission.method
                groups.setdefault(key, []).append((submission, table))
        return [_entry(group) for group in groups.values()]


def _entry(group: list[tuple[Submission, pl.DataFrame]]) -> Entry:
    group = sorted(group, key=lambda pair: (pair[0].created_at, pair[0].id))
    tables = pl.concat([table for _, table in group])
    is_gentle = "violated" in tables.columns
    return Entry(
        submissions=tuple(submission for submission, _ in group),
        returns=np.stack([_returns(table) for _, table in group]),
        success=_share(tables["success"]),
        care=mean_care(care_of(table) for _, table in group) if is_gentle else {},
    )


def _returns(table: pl.DataFrame) -> np.ndarray:
    """Return [P, K], partners in the order of their names."""
    ordered = table.sort("partner", "episode")
    return ordered["return"].to_numpy().astype(float).reshape(ordered["partner"].n_unique(), -1)


def _partners(table: pl.DataFrame) -> list[tuple[str, str]]:
    return table.select("partner", "disability").unique().sort("partner").rows()


def _share(column: pl.Series) -> float:
    return float(column.to_numpy().mean())
