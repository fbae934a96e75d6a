"""What labs and organisers look up and mend by commands."""

import contextlib
import io
import json
import re
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from assistax_board.checking import check_service
from assistax_board.clock import date_of
from assistax_board.folder import about_token
from assistax_board.problems import Problem
from assistax_board.rules.seasons import Plan
from assistax_board.rules.tokens import authenticate, list_tokens
from assistax_board.service import Service
from assistax_board.store.backup import back_up
from assistax_zoo.shell.main import run
from tests.board.fakes import (
    TASK,
    advance,
    ends,
    new_service,
    new_submitter,
    scored,
    season_row,
    state_of,
)
from tests.board.running import served
from tests.board.test_season import open_season
from tests.untrained import published, teams_of

DAY = 86_400.0


def told(*words: Any) -> tuple[int, str, str]:
    """Run a command; return its exit code, what it printed, and its error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def printed(*words: Any) -> str:
    """Return what a command prints that must succeed."""
    code, out, err = told(*words)
    assert code == 0, err
    return out


def refused(*words: Any) -> str:
    """Return the error of a command that must fail."""
    code, _, err = told(*words)
    assert code == 1
    return err


def test_a_lab_lists_and_withdraws_its_submissions(service: Service, tmp_path: Path) -> None:
    season = open_season(service)
    with served(service) as server:
        ada, bob = (server.client("submit", lab) for lab in ("ada", "bob"))
        (tmp_path / "token").write_text(str(ada.token))
        by = ("--url", server.address, "--token-file", tmp_path / "token")
        assert "you have handed in nothing" in printed("submission", "list", *by)
        mine = [
            ada.submit(b"robot 1.0", request_id=f"request-{n}", task="scratch", method=f"m{n}", **s)
            for n, s in enumerate(({}, {"season": "spring"}))
        ]
        other = bob.submit(b"robot 2.0", request_id="request-1", task="scratch", method="theirs")
        advance(service, 1.0)
        lines = printed("submission", "list", *by)
        assert lines.count("\n") == 2 and other["id"] not in lines and "theirs" not in lines
        assert all(f"id {row['id']}  state queued" in lines for row in mine)
        assert f"handed in {date_of(mine[0]['created_at'])}" in lines
        of_season = printed("submission", "list", "--season", "spring", "--json", *by)
        assert [row["id"] for row in json.loads(of_season)] == [mine[1]["id"]]
        assert "reason: withdrawn" in printed("submission", "withdraw", mine[1]["id"], *by)
        assert ends(service, mine[1]["id"]) == ("failed", "refunded")
        assert service.queries.attempts(season)[0].left == 3
        assert "you have no submission" in refused("submission", "withdraw", other["id"], *by)
        assert "no token is given" in refused("submission", "list", "--url", server.address)


def test_an_organiser_lists_and_shows_seasons(tmp_path: Path) -> None:
    data = tmp_path / "board"
    service = new_service(data)
    assert "there is no season" in printed("season", "list", "--data", data)
    season = open_season(service, budget=7)
    scored(service, new_submitter(service, "ada"), 2.0, season=season)
    closes = season_row(service).closes_at
    assert closes is not None
    line = printed("season", "list", "--data", data)
    assert "state open  budget 7  partners A 30, B 30" in line
    assert f"closes {date_of(closes)}" in line
    page = printed("season", "show", "spring", "--data", data)
    assert f"root: {season_row(service).root}" in page and "hides: kinds not recorded" in page
    assert "ada: 1 made, 0 under way, 6 left" in page
    assert "secret-" not in page, "hidden partners stay unnamed"
    answer = json.loads(printed("season", "show", season, "--data", data, "--json"))
    assert (answer["name"], answer["labs"].keys()) == ("spring", {"ada"})


@pytest.fixture
def drafts(tmp_path: Path) -> Service:
    """Make two drafts, spring and summer, of one private release."""
    service = new_service(tmp_path / "board")
    private = published(teams_of(3), tmp_path / "private").parent
    public: Any = SimpleNamespace(policies=())
    for name in ("spring", "summer"):
        service.create_season(Plan(name, TASK, small=True), private, public)
    return service


def test_a_draft_is_deleted_with_its_partners(drafts: Service, tmp_path: Path) -> None:
    data, ledger = tmp_path / "board", drafts.queries.ledger()
    [release] = list((data / "artefacts").glob("??/*"))
    assert "state: draft" in printed("season", "show", "spring", "--data", data)
    printed("season", "delete", "spring", "--data", data)
    assert release.exists(), "the other draft has the same partners"
    printed("season", "delete", "summer", "--data", data)
    assert not release.exists() and drafts.queries.seasons(drafts=True) == []
    assert drafts.queries.ledger() == ledger, "nobody was told of them"
    assert check_service(drafts)["whole"]
    open_season(drafts)
    assert "spring is open; expected draft" in refused("season", "delete", "spring", "--data", data)
    assert state_of(drafts) == "open"


def test_a_draft_has_a_date_that_may_change(drafts: Service, tmp_path: Path) -> None:
    data, ledger = tmp_path / "board", drafts.queries.ledger()
    near, far = (drafts.clock() + days * DAY for days in (30, 60))
    for at in (far, near):  # of a draft an earlier one is as good
        drafts.extend_season("spring", at)
    assert drafts.queries.ledger() == ledger
    drafts.open_season("spring")
    assert season_row(drafts).closes_at == near
    drafts.extend_season("summer", near)
    advance(drafts, 31 * DAY)
    with pytest.raises(Problem, match=f"{re.escape(date_of(near))} is past; give one from"):
        drafts.open_season("summer")
    for act in ("open", "extend"):
        words = ("season", act, "summer", "--data", data, "--closes")
        assert "2020-01-01T00:00:00+00:00 is past; give one from" in refused(*words, "2020-01-01")
        assert "is more than three years ahead; give one from" in refused(*words, "2199-01-01")


def test_a_small_panel_names_its_option(tmp_path: Path) -> None:
    data = tmp_path / "board"
    new_service(data)
    private = published(teams_of(3), tmp_path / "private").parent
    create = ("season", "create", "spring", "--task", TASK, "--release", private, "--data", data)
    assert re.search(
        r"panel B needs 60 .*or plan a small season.*--small does so", refused(*create)
    )
    assert "season spring is made" in printed(*create, "--small")


def test_tokens_are_listed_with_dates(tmp_path: Path) -> None:
    service = new_service(tmp_path / "board")
    service.create_token(("work",), label="one")
    [token] = list_tokens(service.database)
    line = printed("token", "list", "--data", tmp_path / "board")
    assert "created_at 2023-11-14T22:13:20+00:00" in line and "revoked_at" not in line
    printed("token", "revoke", token.id, "--data", tmp_path / "board")
    [row] = json.loads(printed("token", "list", "--data", tmp_path / "board", "--json"))
    assert datetime.fromisoformat(row["revoked_at"]).tzinfo == UTC


def test_restore_tells_of_the_organisers_token(tmp_path: Path) -> None:
    data, again, file = tmp_path / "board", tmp_path / "again", tmp_path / "board.zip"
    service = new_service(data)
    about_token(service, data)
    token = (data / "organiser-token").read_text().strip()
    back_up(data, file)
    said = printed("service", "restore", file, "--data", again)
    assert "no backup has the organiser's token" in said
    command = re.findall(r"`assistax-zoo ([^`]+)`", said)[0].split()
    made = printed(*command).strip()
    for valid in (token, made):
        assert "organise" in authenticate(new_service(again).database, valid).scopes
    assert printed("service", "check", "--backup", file).count("token") == 0
