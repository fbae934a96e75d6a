"""What is damaged or was changed is found, by the organiser and, of the ledger, by anybody."""

from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_board import checking
from assistax_board.app import create_app
from assistax_board.checking import check_ledger, check_service
from assistax_board.client import Client
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.ledger import check_chain
from assistax_board.store.schema import ENTRY
from tests.board.fakes import new_service, new_submitter, scored, shown


@pytest.fixture
def service(tmp_path: Path) -> Service:
    service = new_service(tmp_path)
    scored(service, new_submitter(service))
    return service


def changed(service: Service, statement: Any) -> None:
    with service.database.write() as connection:
        connection.execute(statement)


def test_a_whole_service_is_whole(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checking, "_PAGE", 2)  # several pages
    counts = {"ledger": 3, "artefacts": 4, "receipts": 1, "notices": 0}
    assert check_service(service) == {**counts, "whole": True}
    client = Client("", transport=TestClient(create_app(service)))
    assert check_ledger(client)["entries"] == 3
    assert check_ledger(client)["last_hash"] == service.queries.ledger()[-1].hash


def test_missing_artefact_and_foreign_receipt_are_found(service: Service) -> None:
    [submission] = service.queries.submissions()
    receipt = service.queries.receipt(submission.id)
    assert receipt is not None
    content = receipt["content"] | {"ledger": {"seq": 2, "hash": "0" * 64}}
    signature = service.signer.sign(content)
    changed(service, sa.update(schema.receipts).values(content=content, signature=signature))
    with pytest.raises(ValueError, match="another ledger entry 2"):
        check_service(service)
    service.artefacts.erase(str(shown(service, submission.id).artefact))
    with pytest.raises(ValueError, match="1 of 4 artefacts: no artefact"):
        check_service(service)


def test_changed_ledger_entry_is_found(service: Service) -> None:
    first, entry, last = service.queries.ledger()
    with pytest.raises(ValueError, match="entry 3"):
        check_chain([first, last])
    changed(service, sa.update(schema.ledger).where(ENTRY.seq == 2).values(at=entry.at + 1))
    with pytest.raises(ValueError, match="entry 2 does not follow"):
        check_service(service)
    with pytest.raises(ValueError, match="entry 2 does not follow"):
        check_ledger(Client("", transport=TestClient(create_app(service))))
