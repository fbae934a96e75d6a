"""The record of a run: what every summary, table, figure and page is made of."""

import dataclasses
import functools
from collections.abc import Collection
from pathlib import Path
from typing import Any

import polars as pl

from evaluation.record.manifest import read_manifest
from evaluation.record.returns import Returns, lay_out
from evaluation.record.tables import EPISODES_FILE, read_episodes


@dataclasses.dataclass(frozen=True, eq=False)
class Record:
    """Episodes, and the folder that holds them or what is drawn from them.

    They are laid out when that is first asked for, and once.
    """

    table: pl.DataFrame  # one row an episode
    folder: Path

    @classmethod
    def read(cls, folder: Path) -> "Record":
        """Return the record of a finished folder.

        Raises:
            FileNotFoundError: It holds no episodes.
            ValueError: Their table is damaged.
        """
        return cls(read_episodes(folder / EPISODES_FILE), folder)

    @functools.cached_property
    def returns(self) -> Returns:
        """The episodes as dense arrays.

        Raises:
            ValueError: A pair lacks an episode or has one twice.
        """
        return lay_out(self.table)

    @functools.cached_property
    def manifest(self) -> dict[str, Any]:
        """The folder's manifest when it was first asked for; empty where there is none.

        Raises:
            ValueError: It is not what was written.
        """
        return read_manifest(self.folder) or {}

    def without(self, partners: Collection[str]) -> "Record":
        """Return the record without the episodes of some partners; nothing is laid out again."""
        if not partners:
            return self
        left_out = pl.col("partner").is_in(list(partners))
        rest = Record(self.table.filter(~left_out), self.folder)
        new = self.returns.partners.select(~left_out).to_series().to_numpy()
        rest.__dict__["returns"] = self.returns.select_partners(new)
        return rest
