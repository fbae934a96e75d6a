"""Every line of docs/tables/threats.csv has its tests, and the server dials nobody."""

import csv
import importlib
import inspect
import re
import socket
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.work.worker import Worker
from tests.board.fakes import TASK, FakeScorer, new_service

TABLE = Path(__file__).parents[2] / "docs" / "tables" / "threats.csv"
ADDRESS = "http://169.254.169.254/latest"


def threats(text: str) -> dict[str, list[str]]:
    """Return the tests that each line names."""
    rows = list(csv.reader(text.splitlines()))[1:]
    return {row[0]: re.findall(r"test_\w+(?:::test_\w+)?", row[2]) for row in rows}


def missing(text: str) -> list[str]:
    """Return the lines whose tests are not there."""
    lacking = []
    for threat, names in threats(text).items():
        present = [_is_there(*name.split("::")) for name in names]
        lacking += [] if present and all(present) else [threat]
    return lacking


def _is_there(file: str, test: str = "") -> bool:
    tests = Path(__file__).parents[1]
    rooms = [
        room for room in ("board", "base", "evaluation") if (tests / room / f"{file}.py").is_file()
    ]
    if not rooms:
        return False
    module = importlib.import_module(f"tests.{rooms[0]}.{file}")
    return not test or inspect.isfunction(getattr(module, test, None))


def test_every_threat_has_a_test() -> None:
    text = TABLE.read_text()
    assert len(threats(text)) > 20
    assert missing(text) == []


def test_a_threat_without_a_test_would_be_found() -> None:
    head = "who,what,tests\n"
    assert missing(f"{head}steals,nothing,none\n") == ["steals"]
    assert missing(f"{head}steals,nothing,test_api::test_nothing\n") == ["steals"]
    assert missing(f"{head}dials,nothing,test_threats::test_the_server_dials_nobody\n") == []


@pytest.fixture
def dialled(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Who was dialled by this process; nobody is."""
    tests: list[Any] = []

    def connect(_: socket.socket, address: Any) -> None:
        tests.append(address)
        raise OSError("no network here")

    monkeypatch.setattr(socket.socket, "connect", connect)
    monkeypatch.setattr(socket.socket, "connect_ex", connect)
    return tests


def test_the_server_dials_nobody(tmp_path: Path, dialled: list[Any]) -> None:
    """Addresses stand wherever a submitter can write something, also in the file."""
    service = new_service(tmp_path)
    http = TestClient(create_app(service), raise_server_exceptions=False)
    submitter = Client("", service.create_token(("submit",), submitter=ADDRESS), transport=http)
    fields = {"task": TASK, "method": ADDRESS, "request_id": ADDRESS}
    id = submitter.submit(f"robot 1.0 {ADDRESS}".encode(), **fields)["id"]
    worker = Client("", service.create_token(("work",), label=ADDRESS), transport=http)
    assert Worker(worker, FakeScorer()).run(until_empty=True) == 3
    for path in ("/", f"/tasks/{TASK}", f"/submissions/{id}", f"/api/submissions/{ADDRESS}"):
        http.get(path, headers={"Host": "169.254.169.254", "Referer": ADDRESS})
    assert submitter.submission(id)["state"] == "scored"
    assert dialled == []


def test_who_dials_would_be_found(dialled: list[Any]) -> None:
    with pytest.raises(OSError, match="no network"):
        socket.create_connection(("169.254.169.254", 80), timeout=1)
    assert dialled == [("169.254.169.254", 80)]
