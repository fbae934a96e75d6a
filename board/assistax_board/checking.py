"""Integrity checks of a service: its database, ledger, artefacts and receipts."""

from collections.abc import Iterator
from typing import Any

import sqlalchemy as sa

from assistax_board.client import Client
from assistax_board.problems import Problem
from assistax_board.service import Service
from assistax_board.store.ledger import START, check_chain
from assistax_board.store.notices import list_notices
from assistax_board.store.receipts import verify_receipt
from assistax_board.store.schema import ARTEFACT, RECEIPT
from assistax_board.store.shown import LedgerEntry

_PAGE = 1000  # entries that are read at once


def check_service(service: Service) -> dict[str, Any]:
    """Check all that a service keeps; return the counts.

    Raises:
        ValueError: What is damaged, missing or changed.
    """
    with service.database.read() as connection:
        if service.database.is_sqlite:
            integrity = str(connection.exec_driver_sql("PRAGMA integrity_check(1)").scalar())
            if integrity != "ok":
                integrity = " ".join(integrity.split())
                raise ValueError(f"the database is damaged ({integrity}); restore a backup")
        names = (
            connection.execute(sa.select(ARTEFACT.sha256).where(ARTEFACT.erased_at.is_(None)))
            .scalars()
            .all()
        )
        receipts = (
            connection.execute(sa.select(RECEIPT.content, RECEIPT.signature)).mappings().all()
        )
    entries = list(ledger_pages(service.queries.ledger))
    last = check_chain(entries)
    damaged = [problem for name in names if (problem := _artefact_problem(service, name))]
    if damaged:
        raise ValueError(f"{len(damaged)} of {len(names)} artefacts: {damaged[0]}")
    hashes = {entry.seq: entry.hash for entry in entries}
    for receipt in receipts:
        quoted = verify_receipt(dict(receipt), service.signer.public_key)["ledger"]
        if hashes.get(quoted["seq"]) != quoted["hash"]:
            raise ValueError(f"a receipt quotes another ledger entry {quoted['seq']}")
    counts = {"ledger": last, "artefacts": len(names), "receipts": len(receipts)}
    return {**counts, "notices": len(list_notices(service.database)), "whole": True}


def check_ledger(client: Client) -> dict[str, Any]:
    """Fetch a server's ledger and check its chain; return its end, to be compared later.

    Raises:
        ValueError: An entry was changed, moved or left out.
    """

    def page(after: int, limit: int) -> list[LedgerEntry]:
        answer = client.call("GET", "/api/ledger", params={"after": after, "limit": limit})
        return [LedgerEntry(**entry) for entry in answer.json()]

    previous, seq = START, 0
    for entry in ledger_pages(page):
        seq = check_chain([entry], previous, seq)
        previous = entry.hash
    return {"entries": seq, "last_hash": previous, "whole": True}


def ledger_pages(page: Any) -> Iterator[LedgerEntry]:
    """Yield all entries of a ledger that is read page by page."""
    after = 0
    while entries := page(after, _PAGE):
        yield from entries
        after = entries[-1].seq


def _artefact_problem(service: Service, name: str) -> str | None:
    try:
        service.artefacts.get(name)
    except Problem as problem:
        return str(problem)
    return None
