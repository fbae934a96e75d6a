"""What readers see after an upgrade or a rollback: the version that is served, and no other."""

import threading
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.rules.catalogue import version_id
from assistax_board.rules.scoring import encode_table
from assistax_board.service import Service
from assistax_board.store.schema import MAX_FAILURES
from assistax_board.submitting import watch_submission
from tests.board.fakes import (
    TASK,
    FakeCatalogue,
    FakeScorer,
    advance,
    declared,
    draft,
    new_service,
    new_submitter,
    scored,
    shown,
    take,
    work_off,
)
from tests.board.test_pages_visitors import BOARD, methods
from tests.board.test_season import open_season


def restarted(folder: Path, version: int, later: float = 60.0, url: str | None = None) -> Service:
    """Return the service of a folder as a server of another version starts it."""
    service = new_service(folder, url, version=version)
    advance(service, later)
    service.adopt_version()
    return service


def test_a_rollback_shows_the_scores_of_the_version_served(tmp_path: Path) -> None:
    first = new_service(tmp_path)
    lab = new_submitter(first)
    declared(first, lab, 1.0, 1.1, method="early")
    work_off(first)
    restarted(tmp_path, 2)  # no worker plays anything before it is taken back
    back = restarted(tmp_path, 1, 120.0)
    http = TestClient(create_app(back))
    assert methods(http.get(BOARD).text) == ["early"]
    assert http.get(f"/api/boards/{TASK}").json()["version"] == version_id(
        FakeCatalogue().identity(TASK)
    )
    late, _ = declared(back, lab, 2.0, 2.1, request="r2", method="late")
    work_off(back)
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
    id, _ = declared(first, new_submitter(first), 1.0, 1.1, method="early")
    work_off(first)
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


def answers(service: Service, ids: list[str], version: int) -> list[bool]:
    """Return which submissions have a shown score on panel A under a version."""
    name = version_id(FakeCatalogue(version=version).identity(TASK))
    scores = service.queries.scores(panel="A", version=name)
    return [id in {score.submission for score in scores} for id in ids]


def play_backwards(service: Service, version: int) -> None:
    """Do what waits as many workers would, the last job that they took first."""
    scorer = FakeScorer(version)
    while works := list(iter(lambda: service.lease("w", scorer.versions()), None)):
        for work in reversed(works):
            robot = service.artefacts.get(str(work.artefact))
            table = encode_table(scorer.play(work, robot, None))
            service.result(work.job, work.lease, table, 1.0)


STRENGTHS = (1.0, 5.0, 3.0, 2.0, 9.0, 8.0)  # those that beat all before are shown
SHOWN = [True, True, False, False, True, False]


def ladder_of(service: Service, lab: str, season: str) -> list[str]:
    """Hand in attempts one after another, and return their ids."""
    ids = []
    for number, strength in enumerate(STRENGTHS):
        ids.append(scored(service, lab, strength, f"r{number}", season=season))
        advance(service, 1.0)
    return ids


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_an_upgrade_shows_no_attempt_that_was_silent(
    request: pytest.FixtureRequest, tmp_path: Path, kind: str
) -> None:
    url = request.getfixturevalue("postgres_url") if kind == "postgresql" else None
    first = new_service(tmp_path, url)
    season, lab = open_season(first, budget=9), new_submitter(first)
    ids = ladder_of(first, lab, season)
    assert answers(first, ids, 1) == SHOWN
    upgraded = restarted(tmp_path, 2, url=url)
    new = upgraded.submit(lab, draft(8.5, "new", season=season))
    play_backwards(upgraded, 2)
    assert answers(upgraded, ids, 2) == SHOWN
    assert answers(upgraded, [new], 2) == [False], "it waits for those before it"
    back = restarted(tmp_path, 1, 120.0, url)
    play_backwards(back, 1)
    assert answers(back, [*ids, new], 1) == [*SHOWN, False]


def test_a_bar_that_was_set_before_an_upgrade_stays(tmp_path: Path) -> None:
    """Also where the attempt that set it is not played again."""
    first = new_service(tmp_path)
    season, lab = open_season(first, budget=9), new_submitter(first)
    ids = ladder_of(first, lab, season)
    first.withdraw(ids[4], lab)
    upgraded = restarted(tmp_path, 2)
    new = upgraded.submit(lab, draft(8.5, "new", season=season))
    play_backwards(upgraded, 2)
    assert answers(upgraded, [*ids, new], 2) == [True, True, *[False] * 5]
    upgraded.close_season("spring")
    play_backwards(upgraded, 2)
    played = {score.submission for score in upgraded.queries.scores(panel="B")}
    assert played == {*ids, new} - {ids[4]}, "the method whose score was shown last, whole"


def test_a_failed_replay_does_not_hold_up_the_others(tmp_path: Path) -> None:
    first = new_service(tmp_path)
    season, lab = open_season(first, budget=9), new_submitter(first)
    ids = ladder_of(first, lab, season)
    upgraded = restarted(tmp_path, 2)
    for _ in range(MAX_FAILURES):
        work = take(upgraded, 2)
        assert work.submission == ids[0]
        upgraded.job_failed(work.job, work.lease)
    play_backwards(upgraded, 2)
    assert answers(upgraded, ids, 2) == [False, *SHOWN[1:]]
