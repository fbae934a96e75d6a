"""Groups of a test side's partners, as the results' page shows them."""

import dataclasses
from collections.abc import Mapping

import polars as pl

from evaluation.figures.league import GROUP_ORDER, columns_of, groups_of_table, of_persons


@dataclasses.dataclass(frozen=True)
class GroupMean:
    """Mean with a group of partners, and the ends of its 95% interval."""

    mean: float
    low: float | None
    high: float | None


@dataclasses.dataclass(frozen=True)
class Groups:
    """Means of a task's rows with each group of partners."""

    by_row: Mapping[str, Mapping[str, GroupMean]]

    @classmethod
    def of_table(cls, table: pl.DataFrame) -> "Groups":
        """Return the groups of a table of `evaluation.figures.league.league_table`."""
        known = groups_of_table(table)
        found: dict[str, dict[str, GroupMean]] = {}
        for line in table.iter_rows(named=True):
            means = {name: [line[column] for column in columns_of(name)] for name in known}
            found[line["row"]] = {
                name: GroupMean(*mean) for name, mean in means.items() if mean[0] is not None
            }
        return cls(found)

    @property
    def names(self) -> list[str]:
        """The groups that any row played, in their order."""
        played = set[str]().union(*self.by_row.values())
        return [name for name in GROUP_ORDER if name in played]

    @property
    def of_persons(self) -> list[str]:
        """The rows that played persons alone, where others played teams too."""
        return of_persons(self.by_row)
