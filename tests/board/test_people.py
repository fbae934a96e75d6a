"""The column "with people": accepted logs of recorded mouse paths, each played again."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_board.checking import check_service
from assistax_board.clock import system_clock
from assistax_board.commands.care import service_people
from assistax_board.problems import Problem
from assistax_board.robots.people import accept_people, withdraw_people
from assistax_board.service import Service
from assistax_board.store.database import Database
from assistax_board.vocabulary import PEOPLE
from tests.board.board_data import ROBOTS, add_care, make_app
from tests.people.maker import make_log, signed, write
from zoo.registry import load_registry

CARING = {"people": 7, "episodes": 14, "caring_success": 0.625, "return": 90.0}


def record(folder: Path, **body: Any) -> None:
    """Write an acceptance to the ledger of a folder's service."""
    database = Database(f"sqlite:///{folder / 'service.db'}")
    with database.begin(system_clock) as transaction:
        transaction.record(PEOPLE, {"task": "scratch", "env_version": 1, "logs": [], **body})


def page_of(folder: Path, *acceptances: dict[str, Any]) -> str:
    """Return the board's page after some acceptances; a server may show one a second old."""
    folder.mkdir()
    with TestClient(make_app(folder, ROBOTS[:4])) as client:
        add_care(folder)
        for body in acceptances:
            record(folder, **body)
        assert client.get("/ledger").text.count("env_version") == len(acceptances)
        return client.get("/tasks/scratch").text


@pytest.mark.slow
def test_the_column_is_there_for_accepted_logs_alone(tmp_path: Path) -> None:
    accepted = {"methods": {"self-play": CARING, "nobody's": CARING, "ppo ego": CARING}}
    shown = page_of(tmp_path / "a", {"methods": {}}, accepted)
    assert "With people" in shown and "proves that a person played" in shown
    assert shown.count('data-label="With people">62%') == 1  # of the reference, and no lab's robot
    withdrawn = page_of(tmp_path / "b", accepted, {"methods": {}})
    other = page_of(tmp_path / "c", accepted | {"env_version": 2})
    for page in (page_of(tmp_path / "d"), withdrawn, other):
        assert "Caring success" in page and "With people" not in page


def test_people_are_of_one_task(service: Service) -> None:
    assert service.queries.people("gentle_scratch") is None
    with service.begin() as transaction:
        transaction.record(PEOPLE, {"task": "gentle_bath", "methods": {}, "logs": []})
    assert service.queries.people("gentle_scratch") is None
    with pytest.raises(Problem, match="no figures with people"):
        withdraw_people(service, "gentle_bath")


def test_a_folder_or_a_task_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="give a folder of logs, or"):
        service_people(data=tmp_path)
    with pytest.raises(ValueError, match="give a folder of logs, or"):
        service_people(tmp_path, data=tmp_path, withdraw="gentle_scratch")


@pytest.mark.slow
def test_each_log_is_played_again_before_it_counts(service: Service, tmp_path: Path) -> None:
    registry, logs = load_registry(), tmp_path / "logs"
    for who in (1, 2):
        content = make_log("gentle_scratch", registry, robot="script", start=who, path=who)
        write(content, logs / f"p0{who}" / "script.json")
    result = {**content["result"], "return": content["result"]["return"] + 50.0}
    write(signed({**content, "result": result}), logs / "p02" / "better.json")
    accepted = accept_people(service, logs, registry)
    [body] = accepted.tasks
    assert body["methods"]["script"]["people"] == body["methods"]["script"]["episodes"] == 2
    assert [one.path.name for one in accepted.refused] == ["better.json"]
    [entry] = service.queries.ledger()
    assert (entry.kind, entry.body) == (PEOPLE, body) and len(body["logs"]) == 2
    assert service.queries.people("gentle_scratch") == body
    assert check_service(service)
    (logs / "p01" / "script.json").unlink()  # one withdraws: accepted anew without it
    accept_people(service, logs, registry)
    assert (service.queries.people("gentle_scratch") or {})["methods"]["script"]["people"] == 1
    withdraw_people(service, "gentle_scratch")
    assert (service.queries.people("gentle_scratch") or {})["methods"] == {}
    for path in logs.glob("p02/script.json"):
        path.unlink()
    with pytest.raises(Problem, match="its result says return"):
        accept_people(service, logs, registry)
