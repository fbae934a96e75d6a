"""The board of a closed season: every lab's entries and the references, on panel B."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import polars as pl

from assistax_board.pages.behind import Behind
from assistax_board.pages.boards import bounds_of
from assistax_board.pages.methods import (
    Played,
    ZooFiles,
    digest_of,
    find_copies,
    group_methods,
)
from assistax_board.places.boards import BoardRow, Method, Panel, board_rows
from assistax_board.places.caring import care_of, mean_care
from assistax_board.store.queries import Queries
from assistax_board.store.shown import Season, Submission
from assistax_envs.persons.rows import groups_of
from evaluation.figures.metrics import SEED_SDS

PanelB = Callable[[str], Sequence[tuple[str, pl.DataFrame]]]  # season -> submissions' episodes


@dataclasses.dataclass(frozen=True)
class Entry(Played):
    """A method on panel B: its seeds, how often they succeeded, and how people fared."""

    success: float = 0.0
    care: Mapping[str, float] = dataclasses.field(default_factory=dict)  # see `mean_care`


class SeasonBoards:
    """The boards of closed seasons; each is computed once, behind its readers."""

    def __init__(self, queries: Queries, panel_b: PanelB, zoo_files: ZooFiles) -> None:
        self._queries, self._panel_b, self._zoo_files = queries, panel_b, zoo_files
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
        partners = _partners(self._panel_b(season.id)[0][1])
        [*names], [*settings], [*algorithms] = zip(*partners, strict=True)
        references = {entry.newest.method: entry.returns for entry in entries if entry.is_reference}
        placed = {entry.newest.entry for entry in entries if entry.competes}
        panel = Panel(
            tuple(settings),
            bounds_of(names, references, None),
            groups_of(algorithms),
            SEED_SDS.get(season.task),
            len(self._queries.entries_met(season.id) - placed),
        )
        by_name = {entry.newest.id: entry for entry in entries}
        methods = [Method(id, entry.returns, entry.competes) for id, entry in by_name.items()]
        return tuple((row, by_name[row.name]) for row in board_rows(methods, panel))

    def _entries(self, season: Season) -> list[Entry]:
        tables = dict(self._panel_b(season.id))
        found = map(self._queries.submission, tables)
        groups = group_methods(seed for seed in found if seed is not None)
        returns = {seed.id: _returns(tables[seed.id]) for group in groups for seed in group}
        digests = {id: digest_of(played) for id, played in returns.items()}
        copies = find_copies(groups, digests, self._zoo_files)
        return [_entry(group, tables, returns, copies.get(group[-1].id)) for group in groups]


def _entry(
    group: Sequence[Submission],
    tables: Mapping[str, pl.DataFrame],
    returns: Mapping[str, np.ndarray],
    copy_of: Submission | None,
) -> Entry:
    table = pl.concat([tables[seed.id] for seed in group])
    is_gentle = "violated" in table.columns
    return Entry(
        submissions=tuple(group),
        returns=np.stack([returns[seed.id] for seed in group]),
        copy_of=copy_of,
        success=_share(table["success"]),
        care=mean_care(care_of(tables[seed.id]) for seed in group) if is_gentle else {},
    )


def _returns(table: pl.DataFrame) -> np.ndarray:
    """Return [P, K], partners in the order of their names."""
    ordered = table.sort("partner", "episode")
    return ordered["return"].to_numpy().astype(float).reshape(ordered["partner"].n_unique(), -1)


def _partners(table: pl.DataFrame) -> list[tuple[str, str, str]]:
    return table.select("partner", "disability", "algorithm").unique().sort("partner").rows()


def _share(column: pl.Series) -> float:
    return float(column.to_numpy().mean())
