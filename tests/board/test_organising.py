"""What an organiser is told and may do, by commands and by the page."""

import contextlib
import json
import re
from collections.abc import Callable, Generator, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_board.app import create_app
from assistax_board.checking import check_service
from assistax_board.pages.season_boards import SeasonBoards
from assistax_board.problems import Problem
from assistax_board.serve import open_service
from assistax_board.service import Service
from assistax_board.store.database import Database
from assistax_board.store.notices import list_notices
from assistax_zoo.shell.main import run
from tests.board.fakes import (
    FakeFiles,
    advance,
    close_spring,
    draft,
    ends,
    fail_next_job,
    new_service,
    new_submitter,
    scored,
    season_row,
    shown,
    work_off,
)
from tests.board.test_season import open_season

DAY = 86_400.0


def kinds(service: Service) -> list[str]:
    return [entry.kind for entry in service.queries.ledger()]


def notices(service: Service) -> list[tuple[str, str, int]]:
    return [(row.kind, row.about, row.count) for row in list_notices(service.database)]


def test_failed_submission_is_listed_noticed_and_retried(service: Service) -> None:
    season, lab = open_season(service, budget=1), new_submitter(service)
    id = service.submit(lab, draft(2.0, season=season))
    assert work_off(service, most=1) == 1
    fail_next_job(service)
    assert ends(service, id) == ("failed", "refunded")
    [row] = service.failures()
    assert (row.submission, row.lab, row.season) == (id, "lab", "spring")
    assert (row.failures, row.jobs) == (5, 1)
    assert notices(service) == [("worker_errors", id, 1)]
    service.retry(id)
    assert ends(service, id) == ("queued", "reserved")
    assert notices(service) == [] == service.failures() and kinds(service)[-1] == "retry"
    assert work_off(service) == 4, "what was played stays, and panel A waits for the public half"
    assert ends(service, id) == ("scored", "spent")


def test_retry_after_upgrade_uses_new_version(tmp_path: Path, service: Service) -> None:
    id = service.submit(new_submitter(service), draft(2.0))
    fail_next_job(service)
    upgraded = new_service(tmp_path, version=2)
    upgraded.retry(id)
    assert work_off(upgraded, version=2) == 3 and shown(upgraded, id).state == "scored"


def test_only_what_workers_failed_is_played_again(service: Service) -> None:
    lab = new_submitter(service)
    id = service.submit(lab, draft(2.0))
    with pytest.raises(Problem, match="is queued; only"):
        service.retry(id)
    service.withdraw(id, lab)
    with pytest.raises(Problem, match=r"failed \(withdrawn\)"):
        service.retry(id)
    with pytest.raises(Problem, match="no submission 'x'"):
        service.retry("x")


def test_disqualified_lab_leaves_boards_and_cannot_submit(service: Service) -> None:
    season = open_season(service)
    bad, good = new_submitter(service, "bad"), new_submitter(service, "good")
    ids = [scored(service, lab, 2.0, season=season) for lab in (bad, good)]
    waiting = service.submit(bad, draft(3.0, "r2", season=season))
    assert service.disqualify("spring", "bad") == 2
    taken_back = shown(service, ids[0])
    assert (taken_back.state, taken_back.reason) == ("retracted", "disqualified")
    assert ends(service, waiting) == ("failed", "spent")
    assert {score.submitter for score in service.queries.scores(season=season)} == {"good"}
    with pytest.raises(Problem, match="disqualified you from season spring"):
        service.submit(bad, draft(4.0, "r3", season=season))
    close_spring(service)
    assert {id for id, _ in service.panel_b(season)} == {ids[1]}
    assert kinds(service).count("disqualify") == 1
    with pytest.raises(Problem, match="no submission in season"):
        service.disqualify("spring", "bad")
    with pytest.raises(Problem, match="no lab 'nobody'"):
        service.disqualify("spring", "nobody")


def test_disqualification_after_close_removes_panel_b(service: Service) -> None:
    season, boards = (
        open_season(service),
        SeasonBoards(service.queries, service.panel_b, FakeFiles()),
    )
    for name in ("bad", "good"):
        scored(service, new_submitter(service, name), 2.0, season=season)
    close_spring(service)

    def labs() -> set[str]:
        return {entry.newest.submitter for _, entry in boards.of(season_row(service))}

    assert labs() == {"bad", "good"}
    service.disqualify("spring", "bad")
    assert labs() == {"good"}


def test_a_season_is_extended_and_never_shortened(service: Service) -> None:
    season = open_season(service)
    closes_at = service.queries.seasons()[0].closes_at
    assert closes_at is not None
    service.extend_season("spring", closes_at + DAY)
    with pytest.raises(Problem, match="give a later one"):
        service.extend_season("spring", closes_at)
    advance(service, closes_at - service.clock() + 60.0)
    id = service.submit(new_submitter(service), draft(2.0, season=season))
    assert service.queries.ledger()[-2].body.get("closes_at") == closes_at + DAY
    advance(service, DAY)
    work_off(service)
    assert shown(service, id).state == "scored" and service.queries.seasons()[0].state == "closed"
    assert ("season_closed", "spring", 1) in notices(service)
    with pytest.raises(Problem, match="spring is closed"):
        service.extend_season("spring", closes_at + 3 * DAY)


def test_organiser_gets_notices_of_errors(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    http = TestClient(create_app(service), raise_server_exceptions=False)
    token = service.create_token(("submit",), submitter="lab")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    def broken(*_: object) -> None:
        raise RuntimeError("a hidden value: 0.123")

    fields = {"task": "scratch", "method": "m", "request_id": "12345678"}
    with monkeypatch.context() as patch:
        patch.setattr("assistax_board.store.artefacts.atomic_write", full)
        headers = {"Authorization": f"Bearer {token}"}
        for _ in range(2):
            data = {"params": fields, "content": b"robot 1.0", "headers": headers}
            assert http.post("/api/submissions", **data).status_code == 507
        assert service.queries.submissions() == []
        patch.setattr("assistax_board.store.queries.Queries.seasons", broken)
        assert "has been told" in http.get("/api/seasons").json()["error"]["message"]
    [unexpected, full_disk] = sorted(notices(service), reverse=True)
    assert full_disk == ("too_full", "files", 2) and unexpected[0] == "unexpected"
    assert unexpected[1].startswith("RuntimeError at ") and "hidden value" not in str(unexpected)
    assert check_service(service)["notices"] == 2


def test_commands_print_and_clear_notices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    service, data = open_service(tmp_path / "board"), str(tmp_path / "board")
    service.note("worker_errors", "7kq2")

    def printed(*words: str) -> Any:
        assert run(["service", *words, "--data", data, "--json"]) == 0
        return json.loads(capsys.readouterr().out)

    assert printed("failures") == []
    [notice] = printed("notices", "--clear")
    assert (notice["about"], notice["count"]) == ("7kq2", 1) and "retry" in notice["text"]
    assert printed("notices") == []
    for words, message in (
        (["service", "retry", "x"], "no submission 'x'"),
        (["season", "disqualify", "spring", "lab"], "no season 'spring'"),
        (["season", "extend", "spring", "--closes", "2099-01-01"], "no season 'spring'"),
    ):
        assert run([*words, "--data", data]) == 1
        assert message in capsys.readouterr().err


def test_a_backup_is_checked_as_a_service_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    service, backup = open_service(tmp_path / "board"), tmp_path / "board.zip"
    service.artefacts.put(b"robot")
    assert run(["service", "backup", str(backup), "--data", str(tmp_path / "board")]) == 0
    capsys.readouterr()
    assert run(["service", "check", "--backup", str(backup), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["whole"] is True
    backup.write_bytes(backup.read_bytes()[:-100])
    assert run(["service", "check", "--backup", str(backup)]) == 1
    assert run(["service", "check"]) == 1
    assert "--backup" in capsys.readouterr().err


@pytest.fixture
def browser(service: Service) -> Iterator[TestClient]:
    with TestClient(create_app(service)) as client:
        yield client


def send(browser: TestClient, token: str, **fields: str) -> Any:
    text = browser.get("/organise").text
    hidden = dict(re.findall(r'type="hidden" name="(\w+)" value="(\w*)"', text))
    files = {"unused": ("", b"")}
    return browser.post("/organise", data=hidden | {"account_token": token} | fields, files=files)


def test_the_page_shows_and_acts(service: Service, browser: TestClient) -> None:
    token = service.create_token(("organise",))
    open_season(service)
    id = service.submit(new_submitter(service), draft(2.0))
    fail_next_job(service)
    text = send(browser, token, action="look").text
    assert id in text and "service retry" in text and "spring" in text and token not in text
    assert "is queued again" in send(browser, token, action="retry", submission=id).text
    assert "unbroken chain" in send(browser, token, action="ledger").text
    date = datetime.fromtimestamp(service.clock() + 100 * DAY, UTC).strftime("%Y-%m-%dT%H:%M")
    extended = send(browser, token, action="extend", season="spring", closes=date).text
    assert "closes later" in extended
    assert "no lab" in send(browser, token, action="disqualify", season="spring", lab="x").text
    service.note("too_full", "files")
    seen = str(list_notices(service.database)[0].last_at)
    cleared = send(browser, token, action="clear", seen=seen).text
    assert "files" not in re.sub(r"<form.*", "", cleared)
    assert notices(service) == []


def test_the_page_is_the_organisers_alone(service: Service, browser: TestClient) -> None:
    service.note("too_full", "a-secret-place")
    for token, status in (
        (service.create_token(("submit",), submitter="lab"), 403),
        ("azt_wrong", 401),
        ("", 401),
    ):
        answer = send(browser, token, action="clear", seen="9e99")
        assert answer.status_code == status and "a-secret-place" not in answer.text
    browser.cookies.clear()
    token = service.create_token(("organise",))
    assert browser.post("/organise", data={"account_token": token}).status_code == 403
    assert len(notices(service)) == 1


def between(
    monkeypatch: pytest.MonkeyPatch, act: Callable[[], object], *, before: bool = False
) -> None:
    """Let something happen right after the next transaction, or right before it."""
    whole = Database.write
    acts = [act]

    @contextlib.contextmanager
    def write(database: Database) -> Generator[sa.Connection]:
        if before and acts:
            acts.pop()()
        with whole(database) as connection:
            yield connection
        if acts:
            acts.pop()()

    monkeypatch.setattr(Database, "write", write)


@pytest.mark.parametrize("before", [False, True], ids=["after its commit", "before the upload's"])
def test_erasure_keeps_a_concurrent_equal_file(
    service: Service, monkeypatch: pytest.MonkeyPatch, before: bool
) -> None:
    """Another lab hands in the same bytes; they were removed once the upload was answered."""
    gone, lab = new_submitter(service, "gone"), new_submitter(service)
    service.submit(gone, draft(2.0))
    acts = [lambda: service.submit(lab, draft(2.0)), lambda: service.erase_submitter(gone)]
    first, second = acts if before else acts[::-1]
    between(monkeypatch, second, before=before)
    first()
    assert work_off(service) == 3
    assert check_service(service)["whole"]


def test_erased_lab_cannot_submit_concurrently(
    service: Service, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its file and the names that it wrote would have stayed for ever."""
    gone = new_submitter(service, "gone")
    between(monkeypatch, lambda: service.erase_submitter(gone), before=True)
    with pytest.raises(Problem, match="was erased; ask the organiser for a new token"):
        service.submit(gone, draft(2.0))
    assert service.queries.submissions() == []
    assert not list((tmp_path / "artefacts").glob("*/*"))
