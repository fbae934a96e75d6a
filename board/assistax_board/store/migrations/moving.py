"""Moves a board to another database: whole, compared row by row, and its folder's address last."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.exc import DataError

from assistax_base.digest import json_sha256
from assistax_board.store.addresses import (
    addresses_of,
    are_same,
    database_url,
    extras_named,
    keep_addresses,
)
from assistax_board.store.database import Database
from assistax_board.store.schema import METADATA

_AT_ONCE = 1000  # rows


def move_board(data: Path, source: Database, to: str) -> int:
    """Move the board of a folder to a new database and return the number of rows.

    The database before stays as it is. Until the last step it is the board's; a move that failed
    can be made again.

    Args:
        data: Folder of the board; no server runs on it.
        source: The database now.
        to: URL of the new one.

    Raises:
        ValueError: The new one is not reached, is not empty, or cannot hold a row; a server runs.
    """
    url = database_url(to)
    if are_same(url, source.url):
        raise ValueError(f"the board of {data} is at {url.render_as_string()} already")
    if url.get_backend_name() == "sqlite":
        _make_private(Path(str(url.database)))
    with extras_named():
        target = Database(url.render_as_string(hide_password=False))
    with contextlib.closing(target):
        target.upgrade()
        with source.only_server(), target.only_server(), source.write() as old:
            with target.write() as new:
                count = _copy_once(old, new, url.render_as_string())
            keep_addresses(data, dataclasses.replace(addresses_of(data), database=url))
    return count


def _make_private(path: Path) -> None:
    """Make a database's file that only its owner can read: it has the secrets of seasons."""
    if not path.parent.is_dir():
        raise ValueError(f"there is no folder {path.parent}; make it, or name another database")
    path.touch(mode=0o600)


def _copy_once(old: sa.Connection, new: sa.Connection, name: str) -> int:
    """Copy all rows to an empty database, or find them in one that a move had filled before."""
    there = _digests(old)
    if not any(count for count, _ in _digests(new).values()):
        try:
            for table in _tables():
                for rows in _batches(old, table):
                    new.execute(sa.insert(table), rows)
        except DataError as error:
            reason = str(error.orig).partition("\n")[0]
            raise ValueError(
                f"{name} cannot hold a row of the board ({reason}); nothing was moved"
            ) from None
    if _digests(new) != there:
        raise ValueError(f"{name} holds other rows than the board; name a new, empty database")
    return sum(count for count, _ in there.values())


def _tables() -> Iterator[sa.Table]:
    """Yield the tables, each behind those that it refers to. A JSON of nothing is NULL in both."""
    copies = sa.MetaData()
    for table in METADATA.sorted_tables:
        copy = table.to_metadata(copies)
        for column in copy.columns:
            if isinstance(column.type, sa.JSON):
                column.type = sa.JSON(none_as_null=True)
        yield copy


def _batches(connection: sa.Connection, table: sa.Table) -> Iterator[list[dict[str, Any]]]:
    query = sa.select(table).execution_options(yield_per=_AT_ONCE)
    for part in connection.execute(query).mappings().partitions():
        yield [dict(row) for row in part]


def _digests(connection: sa.Connection) -> dict[str, tuple[int, int]]:
    """Return the number of rows of each table, and a sum of their hashes: databases sort apart."""
    digests = {}
    for table in METADATA.sorted_tables:
        hashes = [
            int(json_sha256(list(row.values())), 16)
            for rows in _batches(connection, table)
            for row in rows
        ]
        digests[table.name] = len(hashes), sum(hashes)
    return digests
