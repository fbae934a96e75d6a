"""What workers failed gets another try: within a lab's attempts, and on panel B of a season."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.problems import Problem
from assistax_board.rules.closing import WAIT_SECONDS
from assistax_board.rules.tokens import submitter_id
from assistax_board.service import Service
from assistax_board.store.notices import list_notices
from tests.board.fakes import (
    FakeCatalogue,
    advance,
    draft,
    ends,
    fail_next_job,
    new_service,
    new_submitter,
    scored,
    shown,
    state_of,
    work_off,
)
from tests.board.test_season import open_season


@pytest.fixture(params=["sqlite", "postgresql"])
def service(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Service]:
    on_sqlite = request.param == "sqlite"
    service = new_service(tmp_path, None if on_sqlite else request.getfixturevalue("postgres_url"))
    yield service
    service.database.close()


def kinds(service: Service) -> list[str]:
    return [notice.kind for notice in list_notices(service.database)]


def unplayed(service: Service) -> Any:
    return service.queries.ledger()[-1].body.get("unplayed")


def test_extra_attempt_needs_the_organiser(service: Service) -> None:
    season, lab = open_season(service, budget=1), new_submitter(service)
    failed = service.submit(lab, draft(2.0, season=season))
    fail_next_job(service)
    service.retry(failed, extra_attempt=True)
    assert service.queries.ledger()[-1].body == {"id": failed}, "an attempt was there"
    fail_next_job(service)
    again = scored(service, lab, 2.0, "r2", season=season)  # with what was given back
    with pytest.raises(Problem, match="used all 1 attempts"):
        service.retry(failed)
    assert ends(service, failed) == ("failed", "refunded")
    service.retry(failed, extra_attempt=True)
    assert service.queries.ledger()[-1].body == {"id": failed, "extra_attempt": True}
    work_off(service)
    assert [shown(service, id).state for id in (failed, again)] == ["scored", "scored"]
    [attempts] = service.queries.attempts(season)
    assert (attempts.spent, attempts.budget, attempts.left) == (2, 1, 0)
    with pytest.raises(Problem, match="0 of 1 attempts"):
        service.submit(lab, draft(3.0, "r3", season=season))


def closing(service: Service) -> tuple[str, list[str]]:
    """Return a season that plays panel B, and the entries of its two labs."""
    season = open_season(service)
    ids = [
        scored(service, new_submitter(service, lab), strength, season=season)
        for lab, strength in (("ada", 2.0), ("bob", 3.0))
    ]
    service.close_season("spring")
    return season, ids


def test_season_waits_for_failed_panel_b_entry(service: Service) -> None:
    season, ids = closing(service)
    failed = fail_next_job(service)
    work_off(service)
    with pytest.raises(Problem, match="spring is closing"):
        dataclasses.replace(service, catalogue=FakeCatalogue(version=2)).adopt_version()
    assert state_of(service, season) == "closing", "the entry must not be dropped"
    assert kinds(service) == ["panel_b"] and shown(service, failed).state == "scored"
    assert [row.submission for row in service.failures()] == [failed]
    http = TestClient(create_app(service))
    assert "The season waits a week" in http.get(f"/seasons/{season}").text
    service.retry(failed)
    assert kinds(service) == [] == service.failures()
    assert service.queries.ledger()[-1].body == {"id": failed, "panel": "B"}
    assert work_off(service) == 1, "what was played stays"
    assert state_of(service, season) == "closed" and unplayed(service) == []
    assert {id for id, _ in service.panel_b(season)} == set(ids)
    assert kinds(service) == ["season_closed"]
    with pytest.raises(Problem, match="is scored; only"):
        service.retry(failed)


def test_season_closes_incomplete_after_a_week(service: Service) -> None:
    season, ids = closing(service)
    failed = fail_next_job(service)
    work_off(service)
    advance(service, WAIT_SECONDS + 60.0)
    assert work_off(service) == 0 and state_of(service, season) == "closed"
    assert unplayed(service) == [failed]
    assert {id for id, _ in service.panel_b(season)} == set(ids) - {failed}
    assert sorted(kinds(service)) == ["panel_b", "season_incomplete"]
    page = TestClient(create_app(service)).get(f"/seasons/{season}").text
    assert "closed without these" in page and f"/submissions/{failed}" in page
    with pytest.raises(Problem, match="closed without it"):
        service.retry(failed)


def test_failed_reference_on_panel_b_is_retried(service: Service) -> None:
    service.add_references()
    season, _ = closing(service)
    while (failed := fail_next_job(service)) and shown(service, failed).kind != "reference":
        service.retry(failed)
        work_off(service, most=2)
    work_off(service)
    assert shown(service, failed).state == "failed" and state_of(service, season) == "closing"
    service.retry(failed)
    work_off(service)
    assert shown(service, failed).state == "scored" and state_of(service, season) == "closed"


@pytest.mark.parametrize("act", ["disqualify", "erase"])
def test_season_does_not_wait_for_removed_lab(service: Service, act: str) -> None:
    season, _ = closing(service)
    failed = shown(service, fail_next_job(service))
    work_off(service)
    if act == "disqualify":
        service.disqualify("spring", failed.submitter)
        assert unplayed(service) == []
    else:
        service.erase_submitter(submitter_id(service.database, failed.submitter))
    assert state_of(service, season) == "closed"


def test_closing_season_waits_for_failed_submissions(service: Service) -> None:
    season, lab = open_season(service), new_submitter(service)
    early = service.submit(lab, draft(1.0, season=season))
    fail_next_job(service)
    advance(service, 10.0)
    late = service.submit(lab, draft(2.0, "r2", season=season))
    service.close_season("spring")
    advance(service, 10.0)
    assert fail_next_job(service) == late and state_of(service, season) == "closing"
    service.retry(late)
    work_off(service)
    assert state_of(service, season) == "closed"
    assert [id for id, _ in service.panel_b(season)] == [late] != [early]
    with pytest.raises(Problem, match="plays panel B, or has"):
        service.retry(early)
