"""What readers see after an upgrade or a rollback: the version that is served, and no other."""

import threading
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.rules.catalogue import version_id
from assistax_board.service import Service
from assistax_board.submitting import watch_submission
from tests.board.fakes import (
    TASK,
    FakeCatalogue,
    advance,
    draft,
    new_service,
    new_submitter,
    scored,
    shown,
    work_off,
)
from tests.board.test_pages_visitors import BOARD, methods


def restarted(folder: Path, version: int, later: float = 60.0) -> Service:
    """Return the service of a folder as a server of another version starts it."""
    service = new_service(folder, version=version)
    advance(service, later)
    service.adopt_version()
    return service


def test_a_rollback_shows_the_scores_of_the_version_served(tmp_path: Path) -> None:
    first = new_service(tmp_path)
    lab = new_submitter(first)
    scored(first, lab, 1.0, method="early")
    restarted(tmp_path, 2)  # no worker plays anything before it is taken back
    back = restarted(tmp_path, 1, 120.0)
    http = TestClient(create_app(back))
    assert methods(http.get(BOARD).text) == ["early"]
    assert http.get(f"/api/boards/{TASK}").json()["version"] == version_id(
        FakeCatalogue().identity(TASK)
    )
    late = scored(back, lab, 2.0, "r2", method="late")
    http = TestClient(create_app(back))  # with pages as they are now
    watched = watch_submission(Client("http://testserver", transport=http, patience=0.0), late)
    assert (watched["state"], watched["of_methods"]) == ("scored", 2)
    assert methods(http.get(BOARD).text) == ["late", "early"]


def test_a_rollback_plays_what_the_upgrade_dropped(tmp_path: Path) -> None:
    first = new_service(tmp_path)
    id = first.submit(new_submitter(first), draft())
    work_off(first, most=1)
    upgraded = restarted(tmp_path, 2)
    assert work_off(upgraded, version=2, most=1) == 1
    back = restarted(tmp_path, 1, 120.0)
    assert work_off(back, version=2) == 0, "its jobs left with its version"
    assert work_off(back) == 2, "what was played stays"
    assert shown(back, id).state == "scored"
    assert back.adopt_version() == 0
    again = restarted(tmp_path, 2, 180.0)
    assert work_off(again, version=2) == 2
    assert {score.version for score in again.queries.scores(submission=id)} == {
        version_id(FakeCatalogue(version=version).identity(TASK)) for version in (1, 2)
    }


def test_an_upgrade_says_that_files_are_played_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = new_service(tmp_path)
    id = scored(first, new_submitter(first), 1.0, method="early")
    broke: list[object] = []
    monkeypatch.setattr(threading, "excepthook", broke.append)
    upgraded = restarted(tmp_path, 2)
    http = TestClient(create_app(upgraded))
    page = http.get(BOARD).text
    [before] = [name for name, _ in first.queries.versions(TASK)[:1]]
    assert "are played anew" in page and f"{BOARD}?version={before}" in page
    assert methods(http.get(f"{BOARD}?version={before}").text) == ["early"]
    assert http.get(f"{BOARD}.csv").status_code == 404
    client = Client("http://testserver", transport=http, patience=0.0)
    watched = watch_submission(client, id)
    assert watched["state"] == "scored" and "of_methods" not in watched
    assert not broke
    work_off(upgraded, version=2)
    assert watch_submission(client, id)["of_methods"] == 1
