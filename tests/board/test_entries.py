"""Declared entries: frozen before the first score, whole from then on, ranked as one method."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic import command
from sqlalchemy.exc import IntegrityError
from starlette.testclient import TestClient

from assistax_base.digest import sha256
from assistax_board.app import create_app
from assistax_board.cards import Card
from assistax_board.pages.boards import Board, Boards
from assistax_board.pages.crossplays import CrossPlays
from assistax_board.pages.methods import ZooFiles
from assistax_board.pages.season_boards import SeasonBoards
from assistax_board.places import boards
from assistax_board.problems import Problem
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.database import Database, alembic_config
from assistax_board.store.notices import list_notices
from tests.board.fakes import (
    TASK,
    FakeFiles,
    advance,
    close_spring,
    declaration,
    declared,
    draft,
    ends,
    fail_next_job,
    new_submitter,
    scored,
    season_row,
    shown,
    work_off,
)
from tests.board.running import served
from tests.board.test_season import open_season


def board_of(service: Service, files: ZooFiles | None = None) -> Board:
    board = Boards(service.queries, CrossPlays(Path("none")), files or FakeFiles()).of(TASK)
    assert board is not None
    return board


def places(service: Service) -> dict[str, int | None]:
    """Return the place of each method by its lab."""
    return {played.newest.submitter: row.place for row, played in board_of(service).rows}


def test_only_a_whole_declared_entry_takes_a_place(service: Service) -> None:
    declared(service, new_submitter(service, "ada"), 1.0, 1.1, 1.2)
    for number, strength in enumerate((5.0, 6.0)):  # the best two of many, as it were
        scored(service, new_submitter(service, "bob"), strength, f"r{number}")
    declared(service, new_submitter(service, "cy"), 7.0, 7.1)
    fail_next_job(service)
    work_off(service)
    assert places(service) == {"cy": None, "bob": None, "ada": 1}
    board = board_of(service)
    words = {played.newest.submitter: played.seeds_in_words for _, played in board.rows}
    said = {"cy": "1 of 2 declared", "bob": "2 single robots", "ada": "3 of 3 declared"}
    assert words == said
    assert [row[1].newest.submitter for row in board.singles] == ["bob"]


def test_an_entry_is_played_when_all_of_it_is_there(service: Service) -> None:
    lab = new_submitter(service)
    entry = service.declare(lab, declaration(1.0, 2.0))
    first = service.submit(lab, draft(1.0, "r1", entry=entry))
    assert work_off(service) == 0
    assert (shown(service, first).place, shown(service, first).declared) == (None, 2)
    assert dataclasses.replace(service).adopt_version() == 0, "an upgrade plays no part of it"
    second = service.submit(lab, draft(2.0, "r2", entry=entry))
    assert work_off(service) == 6
    assert {shown(service, id).state for id in (first, second)} == {"scored"}


def test_a_file_with_a_score_enters_no_entry(service: Service) -> None:
    """Twenty robots are tried under one name, and the best are declared under another."""
    lab = new_submitter(service)
    entry = service.declare(lab, declaration(3.0, 4.0))
    service.submit(lab, draft(3.0, "r3", entry=entry))
    scored(service, new_submitter(service, "throwaway"), 4.0)
    with pytest.raises(Problem, match="was scored before"):
        service.submit(lab, draft(4.0, "r4", entry=entry))
    with pytest.raises(Problem, match="was scored before"):
        service.declare(lab, declaration(4.0, 5.0, request="e2", method="other"))
    assert work_off(service) == 0


def test_part_of_an_entry_is_no_entry_but_all_of_it_is(service: Service) -> None:
    season, lab = open_season(service, budget=9), new_submitter(service)
    declared(service, lab, 1.0, 2.0, 3.0)
    work_off(service)
    advance(service, 1.0)
    with pytest.raises(Problem, match="was scored before"):
        service.declare(lab, declaration(2.0, 3.0, request="e2", season=season))
    again = declared(service, lab, 1.0, 2.0, 3.0, request="e3", season=season)
    work_off(service)
    assert {shown(service, id).state for id in again} == {"scored"}
    board = board_of(service)
    assert {(row.place, bool(played.copy_of)) for row, played in board.rows} == {
        (1, False),
        (None, True),
    }


def test_nothing_leaves_an_entry_alone(service: Service) -> None:
    lab = new_submitter(service)
    waiting = declared(service, lab, 1.0, 2.0)
    service.withdraw(waiting[0], lab)
    assert {ends(service, id) for id in waiting} == {("failed", "free")}
    lasting = declared(service, lab, 1.0, 2.0, request="e2", method="other")
    work_off(service, most=3)  # one of the two is scored
    for id in lasting:
        with pytest.raises(Problem, match="stays whole from its first score on"):
            service.withdraw(id, lab)
    work_off(service)
    assert {shown(service, id).state for id in lasting} == {"scored"}


def test_an_entry_gets_no_second_chance(service: Service) -> None:
    """Further seeds of one name, and other files than were declared, are refused."""
    lab = new_submitter(service)
    declared(service, lab, 1.0, 2.0)
    with pytest.raises(Problem, match="give this one another name"):
        service.declare(lab, declaration(5.0, 6.0, request="e2"))
    entry = service.declare(lab, declaration(5.0, 6.0, request="e3", method="other"))
    assert entry == service.declare(lab, declaration(5.0, 6.0, request="e3", method="other"))
    fields = {"entry": entry, "method": "other"}
    for wrong, problem in (
        (draft(7.0, "r7", **fields), "did not declare a file"),
        (draft(5.0, "r8", **fields | {"method": "mine"}), "method is 'mine'"),
        (draft(5.0, "r9", **fields | {"entry": "none"}), "you have no entry"),
    ):
        with pytest.raises(Problem, match=problem):
            service.submit(lab, wrong)
    service.submit(lab, draft(5.0, "r5", **fields))
    with pytest.raises(Problem, match="has this file"):
        service.submit(lab, draft(5.0, "r6", **fields))
    with pytest.raises(Problem, match="you have no entry"):
        service.submit(new_submitter(service, "thief"), draft(6.0, "r1", **fields))


def test_a_refused_file_ends_its_entry(service: Service) -> None:
    lab = new_submitter(service)
    files = (*declaration(1.0).files, sha256(b"test1"))
    entry = service.declare(lab, dataclasses.replace(declaration(1.0, 2.0), files=files))
    first = service.submit(lab, draft(1.0, "r1", entry=entry))
    refused = service.submit(lab, draft(request="r2", data=b"test1", entry=entry))
    assert (shown(service, refused).state, shown(service, first).reason) == (
        "refused",
        "entry_incomplete",
    )
    with pytest.raises(Problem, match="has ended; declare it again"):
        service.submit(lab, draft(1.0, "r3", entry=entry))


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"files": ("0" * 64,)}, "1 files; an entry has 2 to 10"),
        ({"files": tuple(f"{i:064x}" for i in range(11))}, "11 files"),
        ({"files": ("0" * 64,) * 2}, "two files are the same"),
        ({"files": ("0" * 64, "F" * 64)}, "give its sha256"),
        ({"task": "chess"}, "task 'chess'"),
        ({"method": "a\nb"}, "method has 1 to 80"),
        ({"season": "gone"}, "no season 'gone'"),
        ({"card": Card(0, "p", "c", 2)}, "steps is 0"),
        ({"card": Card(1, "p", "c", 1)}, "trained is 1 and there are 2 files"),
        ({"card": Card(1, "", "c", 2)}, "partners has 1 to 200"),
        ({"card": Card(1, "p", "c" * 201, 2)}, "code has 1 to 200"),
    ],
)
def test_a_wrong_declaration_is_one_clear_error(
    service: Service, changes: dict[str, Any], problem: str
) -> None:
    lab = new_submitter(service)
    with pytest.raises(Problem, match=problem):
        service.declare(lab, dataclasses.replace(declaration(1.0, 2.0), **changes))


def test_a_season_takes_an_entry_whole(service: Service) -> None:
    season, lab = open_season(service, budget=9), new_submitter(service)
    with pytest.raises(Problem, match="9 of 9 attempts of season spring are left and 10 needed"):
        service.declare(lab, declaration(*range(10), season=season))
    wide = declared(service, lab, 1.0, 2.0, 3.0, season=season, method="wide")
    deep = declared(service, lab, 4.0, 5.0, request="e2", season=season, method="deep")
    work_off(service)
    service.enter(season, lab, wide[:1])
    close_spring(service)
    assert {score.submission for score in service.queries.scores(panel="B")} == set(wide)
    [(row, entry)] = SeasonBoards(service.queries, service.panel_b, FakeFiles()).of(
        season_row(service)
    )
    assert (row.place, entry.seeds_in_words) == (1, "3 of 3 declared")
    assert not shown(service, deep[0]).entered


def test_the_default_entry_is_all_of_a_method(service: Service) -> None:
    """Seeds that the Ladder was silent of play too; a single robot does not go before an entry."""
    season, lab = open_season(service, budget=9), new_submitter(service)
    seeds = declared(service, lab, 3.0, 2.0, 1.0, season=season)
    work_off(service)
    scored(service, lab, 8.0, "r8", season=season, method="lucky")
    close_spring(service)
    assert {score.submission for score in service.queries.scores(panel="B")} == set(seeds)


def test_an_entry_without_all_files_does_not_hold_a_season(service: Service) -> None:
    season, lab = open_season(service), new_submitter(service)
    entry = service.declare(lab, declaration(1.0, 2.0, season=season))
    id = service.submit(lab, draft(1.0, "r1", season=season, entry=entry))
    close_spring(service)
    assert shown(service, id).reason == "season_closed"
    assert season_row(service).state == "closed"


def test_entries_that_vanish_still_count(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot may break down where it does badly, so that its entry has no place."""
    for lab, strength in (("ada", 100.0), ("bob", 300.0)):
        declared(service, new_submitter(service, lab), strength, strength + 0.5)
    work_off(service)
    assert places(service) == {"ada": 2, "bob": 1}
    asked: list[int] = []
    real = boards.rank_methods

    def rank(scores: Any, **options: Any) -> Any:
        asked.append(options["unseen"])
        return real(scores, **options)

    monkeypatch.setattr(boards, "rank_methods", rank)
    for lab in ("cy", "di"):
        declared(service, new_submitter(service, lab), 2.0, 2.0 + len(lab) + ord(lab[0]))
        fail_next_job(service)
        work_off(service)
    board_of(service)
    assert asked == [2]


def test_the_same_robot_of_three_labs_has_one_place(service: Service) -> None:
    for lab in ("ada", "bob", "cy"):
        declared(service, new_submitter(service, lab), 1.0, 2.0)
        work_off(service)
        advance(service, 1.0)
    assert places(service) == {"ada": 1, "bob": None, "cy": None}
    notices = {notice.about: notice for notice in list_notices(service.database)}
    assert set(notices) == set(declaration(1.0, 2.0).files)
    assert {(notice.kind, notice.count) for notice in notices.values()} == {("same_bytes", 2)}
    http, copy = TestClient(create_app(service)), service.queries.submissions()[0].id
    marks = {path: http.get(path).text.count("same robot as") for path in ("/", f"/tasks/{TASK}")}
    assert marks == {"/": 2, f"/tasks/{TASK}": 2}
    page = http.get(f"/submissions/{copy}/method").text
    assert page.count("same robot as") == 1
    assert "Gap over" not in page, "its partners have one setting"


def test_other_bytes_with_the_same_returns_are_the_same_robot(service: Service) -> None:
    scored(service, new_submitter(service, "first"), data=b"robot 4.0")
    advance(service, 1.0)
    lab = new_submitter(service, "renamed")
    files = (b"robot 4.00", b"robot 5.0")
    made = dataclasses.replace(declaration(1.0, 2.0), files=tuple(map(sha256, files)))
    entry = service.declare(lab, made)
    for number, data in enumerate(files):
        service.submit(lab, draft(request=f"r{number}", data=data, entry=entry))
    work_off(service)
    assert places(service) == {"renamed": None, "first": None}


def test_an_entry_is_declared_over_http(service: Service) -> None:
    with served(service) as server:
        client = server.client("submit")
        files = list(declaration(1.0, 2.0).files)
        card = {"steps": 5, "partners": "none", "code": "not published", "trained": 4}
        fields = {"task": TASK, "method": "wide"}
        entry = client.declare(request_id="request-1", files=files, card=card, **fields)
        for strength in (1.0, 2.0):
            sent = client.submit(
                f"robot {strength}".encode(), request_id=f"file-{strength}", entry=entry, **fields
            )
        assert sent["card"] == card and sent["declared"] == 2
        work_off(service)
        standing = client.standing(sent["id"])
        assert (standing["board_place"], standing["of_methods"]) == (1, 1)
        page = TestClient(create_app(service)).get(f"/submissions/{sent['id']}").text
        assert "seeds trained" in page and "picked before that" in page
        for wrong in ({"card": {}}, {"files": "x"}, {"request_id": "short"}):
            known: dict[str, Any] = {"request_id": "request-2", "files": files, "card": card}
            with pytest.raises(Problem, match="body"):
                client.declare(**known | fields | wrong)


def test_an_erased_lab_leaves_no_card(service: Service) -> None:
    lab = new_submitter(service)
    declared(service, lab, 1.0, 2.0)
    work_off(service)
    service.erase_submitter(lab)
    with service.database.read() as connection:
        [row] = connection.execute(sa.select(schema.entries)).all()
    assert (row.method, row.card) == ("erased", {})


def test_what_was_there_becomes_single_robots(tmp_path: Path) -> None:
    """The migration of a board whose submissions were seeds by their name."""
    database = Database(f"sqlite:///{tmp_path / 'service.db'}")
    command.upgrade(alembic_config(database.url), "schema_1")
    with database.write() as connection:
        connection.execute(
            sa.text("INSERT INTO submitters (id, name, created_at) VALUES ('l', 'lab', 0)")
        )
        connection.execute(
            sa.text(
                "INSERT INTO submissions (id, submitter, request, task, method, kind, licence, "
                "state, attempt, turn, created_at) VALUES ('s', 'l', 'r', 'scratch', 'old', "
                "'file', 'MIT', 'queued', 'free', 0, 0)"
            )
        )
    database.upgrade()
    with database.read() as connection:
        row = connection.execute(sa.select(schema.submissions)).one()
        assert (row.id, row.method, row.entry) == ("s", "old", None)
        assert connection.execute(sa.select(schema.entries)).all() == []
    with database.write() as connection, pytest.raises(IntegrityError):
        connection.execute(sa.update(schema.submissions).values(entry="nobody's"))
