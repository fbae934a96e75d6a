"""The ledger: every submission, score and act of an organiser, chained by hashes.

Entries hold ids, hashes and released figures, never a name: a person's data can go and the chain
still holds.
"""

from collections.abc import Iterable
from typing import Any

import sqlalchemy as sa

from assistax_base.digest import json_sha256
from assistax_board.store.schema import ledger
from assistax_board.store.shown import LedgerEntry

START = "0" * 64  # the hash before the first entry


def append(connection: sa.Connection, at: float, kind: str, body: dict[str, Any]) -> LedgerEntry:
    """Add an entry in the transaction of the event that it records, and return it."""
    query = sa.select(ledger.c.seq, ledger.c.hash).order_by(ledger.c.seq.desc()).limit(1)
    last = connection.execute(query).first()
    seq, previous = (1, START) if last is None else (last.seq + 1, last.hash)
    entry = LedgerEntry(seq, at, kind, body, previous, entry_hash(seq, at, kind, body, previous))
    connection.execute(sa.insert(ledger).values(**vars(entry)))
    return entry


def entry_hash(seq: int, at: float, kind: str, body: dict[str, Any], previous: str) -> str:
    """Return the sha256 over an entry and the hash of the one before."""
    return json_sha256([seq, at, kind, body, previous])


def check_chain(entries: Iterable[LedgerEntry], previous: str = START, seq: int = 0) -> int:
    """Return the number of the last entry of an unbroken chain.

    Raises:
        ValueError: An entry is missing, was changed, or does not follow the one before.
    """
    for entry in entries:
        expected = entry_hash(entry.seq, entry.at, entry.kind, entry.body, previous)
        if (entry.seq, entry.previous, entry.hash) != (seq + 1, previous, expected):
            raise ValueError(
                f"ledger entry {entry.seq} does not follow entry {seq}: it was changed, moved or "
                "left out; compare with a copy of the ledger, receipts quote its hashes"
            )
        seq, previous = entry.seq, entry.hash
    return seq
