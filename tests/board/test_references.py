"""The zoo's robots on a board: declared entries that no lab's rank depends on, with films."""

import functools
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_base.digest import sha256
from assistax_board import pages
from assistax_board.app import create_app
from assistax_board.cards import Card
from assistax_board.pages import videos
from assistax_board.pages.methods import ZooFiles
from assistax_board.pages.season_boards import SeasonBoards
from assistax_board.rules.catalogue import ZooCatalogue, ZooEntry
from assistax_board.service import Service
from assistax_board.submitting import read_file
from tests.board.fakes import (
    TASK,
    FakeCatalogue,
    FakeFiles,
    close_spring,
    declared,
    draft,
    new_service,
    new_submitter,
    scored,
    season_row,
    shown,
    work_off,
)
from tests.board.test_entries import board_of, places
from tests.board.test_pages import Films
from tests.board.test_season import open_season
from zoo.registry import load_registry

ROBOT = "ppo-ego-s0-v1"  # of the registry
ENTRY = ZooEntry(
    "ppo ego",
    Card(100, "training side of half", "assistax-zoo train-ego", 2),
    {ROBOT: "1" * 64, "ppo-ego-s1-v1": "2" * 64},
)


@pytest.fixture
def service(tmp_path: Path) -> Service:
    service = new_service(tmp_path / "board")
    publish(service, ENTRY)
    return service


def publish(service: Service, *entries: ZooEntry) -> None:
    assert isinstance(service.catalogue, FakeCatalogue)
    service.catalogue.entries = entries
    service.add_references()


def test_a_new_board_shows_the_zoo(service: Service) -> None:
    work_off(service)
    board = board_of(service)
    [(standing, played)] = board.published
    assert (played.newest.method, played.seeds_in_words) == ("ppo ego", "2 of 2 declared")
    assert (standing.place, played.competes, played.newest.declared) == (None, False, 2)
    assert (board.methods, board.singles) == ((), ())
    assert played.newest.card == {
        **{"steps": 100, "partners": "training side of half"},
        **{"code": "assistax-zoo train-ego", "trained": 2},
    }
    kinds = [entry.kind for entry in service.queries.ledger()]
    assert kinds.index("declare") < kinds.index("score"), "frozen before its first score"
    entries = len(service.queries.ledger())
    service.add_references()
    assert len(service.queries.ledger()) == entries, "a second start adds nothing"


def test_no_rank_depends_on_the_zoo(service: Service, tmp_path: Path) -> None:
    alone = new_service(tmp_path / "alone")
    for one in (service, alone):
        season = open_season(one, budget=9)
        for lab, strengths in (("ada", (1000.0, 1001.0)), ("bob", (3000.0, 3001.0))):
            declared(one, new_submitter(one, lab), *strengths, season=season)
        # One seed of the zoo is scored, the other is not.
        work_off(one, most=23)
    of_labs = {lab: place for lab, place in places(service).items() if lab != "reference"}
    assert of_labs == places(alone) == {"ada": 2, "bob": 1}
    for one in (service, alone):
        work_off(one)
        close_spring(one)
    assert {lab: place for lab, place in places(service).items() if place} == places(alone)
    rows = [
        SeasonBoards(one.queries, one.panel_b, FakeFiles()).of(season_row(one))
        for one in (service, alone)
    ]
    of_season = [
        {e.newest.submitter: (row.place, row.lowest) for row, e in found if not e.is_reference}
        for found in rows
    ]
    assert of_season[0] == of_season[1] and len(of_season[0]) == 2
    assert any(entry.is_published for _, entry in rows[0])
    assert service.queries.entries_met(season_row(service).id) == {
        shown(service, row.id).entry
        for row in service.queries.submissions(season=season_row(service).id)
        if row.kind == "file"
    }


def test_the_zoos_robot_in_a_labs_hands_is_a_copy(service: Service) -> None:
    """By its bytes, and by its returns; the lab may come before the zoo's row is played."""
    files = FakeFiles({ROBOT: b"robot 5.0"})
    season = open_season(service, budget=9)
    for lab, strengths in (("bytes", (5.0, 6.0)), ("returns", (7.0, 9.0)), ("own", (1.0, 2.0))):
        declared(service, new_submitter(service, lab), *strengths, season=season)
    work_off(service)
    close_spring(service)
    of_season = SeasonBoards(service.queries, service.panel_b, files).of(season_row(service))
    for rows in (board_of(service, files).rows, of_season):
        by_lab = {played.newest.submitter: (row.place, played.copy_of) for row, played in rows}
        assert by_lab["own"] == (1, None)
        for lab in ("bytes", "returns"):
            place, earlier = by_lab[lab]
            assert place is None
            assert earlier is not None and earlier.reference in ENTRY.seeds
    [unmarked] = [p for _, p in board_of(service).rows if p.newest.submitter == "bytes"]
    assert unmarked.copy_of is None, "its returns are its own"


def test_a_robot_that_the_registry_lost_leaves_the_board(service: Service) -> None:
    work_off(service)
    publish(service, ZooEntry("ppo ego", ENTRY.card, {ROBOT: "1" * 64}))
    work_off(service)
    [(_, played)] = board_of(service).published
    assert [seed.reference for seed in played.submissions] == [ROBOT]
    assert played.newest.declared == 1
    publish(service)
    assert not board_of(service).published
    publish(service, ENTRY)
    assert len(board_of(service).published) == 0, "what was taken back does not come again"


def test_a_board_of_before_gets_its_entries(tmp_path: Path) -> None:
    """Rows of published robots that stood on their own are put together, and not played anew."""
    service = new_service(tmp_path / "board")
    assert isinstance(service.catalogue, FakeCatalogue)
    plain = dict.fromkeys(ENTRY.seeds, "ppo ego")
    catalogue: Any = service.catalogue
    catalogue.references = lambda task: plain
    service.add_references()
    work_off(service)
    assert not board_of(service).published
    del catalogue.references
    publish(service, ENTRY)
    assert len(board_of(service).published) == 1
    assert work_off(service) == 2 * 3, "zero-action and self-play alone are new"


def test_the_care_track_has_its_robots_on_the_board() -> None:
    catalogue = ZooCatalogue(load_registry(), "native")
    for task in ("gentle_scratch", "gentle_bath"):
        [*entries] = catalogue.published(task)
        assert entries, "the track publishes robots"
        methods = catalogue.references(task)
        for entry in entries:
            assert len(entry.seeds) >= 3
            assert {methods[name] for name in entry.seeds} == {entry.method}
            assert entry.card.partners.startswith(f"training side of {task}/persons-")
            assert entry.card.steps > 10**6


def test_the_zoos_robots_are_known_by_their_files() -> None:
    registry, task = load_registry(), "gentle_scratch"
    names = ZooFiles(registry).names(task)
    [entry] = ZooCatalogue(registry, "native").published(task)
    for name in entry.seeds:
        robot = read_file(Path(f"{task}/{name}"))  # as `submit` sends it
        assert names[sha256(robot)] == name
        assert sha256(robot + b" ") not in names


@pytest.fixture
def films(monkeypatch: pytest.MonkeyPatch) -> Films:
    """Stands for the command line, which takes half a second."""
    made = Films()

    def run(words: Any, folder: Path, registry: Any) -> None:
        time.sleep(0.5)
        made(words, folder)

    monkeypatch.setattr(pages, "run_command", run)
    return made


@pytest.fixture
def reader(tmp_path: Path, service: Service, films: Films) -> Iterator[TestClient]:
    with TestClient(create_app(service, films=tmp_path / "films")) as client:
        yield client


def test_the_home_page_shows_a_film_of_each_robot(reader: TestClient, films: Films) -> None:
    page = reader.get("/").text
    assert page.count("Its film is being made") == 1, "the page does not wait for it"
    end = time.monotonic() + 60
    while "<video" not in (page := reader.get("/").text) and "<img" not in page:
        assert time.monotonic() < end
        time.sleep(0.2)
    [film] = re.findall(r'class="film" src="([^"]+)"', page)
    assert reader.get(film).content == b"film"
    commands = [words[0] for words in films.commands]
    assert commands == ["render", "watch", "crossplay"]
    for _ in range(3):
        reader.get("/")
    assert len(films.commands) == 3, "it is made once"
    human = films.commands[0][films.commands[0].index("--human") + 1].removeprefix("zoo:")
    registry = load_registry()
    assert registry.split(TASK).side(registry.policy(human).team) == "train"
    [link] = re.findall(r'href="(/submissions/\w+/film)"', page)
    assert f'src="{link}/file"' in reader.get(link).text
    assert reader.get(f"{link}/file").content == b"film"


def test_a_film_that_fails_is_not_made_again_and_again(
    reader: TestClient, films: Films, monkeypatch: pytest.MonkeyPatch
) -> None:
    films.fails = True
    end = time.monotonic() + 60
    while "No film could be made of it" not in reader.get("/").text:
        assert time.monotonic() < end
        time.sleep(0.2)
    for _ in range(3):
        assert reader.get("/").status_code == 200
    assert len(films.commands) == 1
    monkeypatch.setattr(videos, "AGAIN_SECONDS", 0.0)
    films.fails = False
    while "<video" not in (page := reader.get("/").text) and "<img" not in page:
        assert time.monotonic() < end
        time.sleep(0.2)


def test_a_lab_has_a_page_with_nothing_private(service: Service, reader: TestClient) -> None:
    season = open_season(service, budget=9)
    name = "Lab of Ada & <Co>/Grace"
    assert reader.get("/labs/reference").status_code == 404, "nothing of it was scored yet"
    lab = new_submitter(service, name)
    link = "https://arxiv.org/abs/1"
    card = Card(5, "train side", "https://example.org/code", 2)
    declared(service, lab, 1.0, 1.4, card=card)
    scored(service, lab, 2.0, "single", method="alone", link=link)
    scored(service, lab, 2.5, "of season", method="in a season", season=season)
    refused = service.submit(lab, draft(request="bad", method="bad one", data=b"nothing"))
    waiting = service.submit(lab, draft(3.0, "waits", method="waiting one"))
    address = "/labs/Lab%20of%20Ada%20%26%20%3CCo%3E/Grace"
    assert f'href="{address}"' in reader.get(f"/tasks/{TASK}").text
    page = reader.get(address).text
    assert "Lab of Ada &amp; &lt;Co&gt;/Grace" in page and "<Co>" not in page
    for text in ("2 of 2 declared", "alone", "in a season", card.code, link):
        assert text in page
    for text in (refused, waiting, "bad one", "waiting one", "season1", "spring", "attempt"):
        assert text not in page
    work_off(service)
    assert "2 of 2 declared" in reader.get("/labs/reference").text
    assert ">zoo</a> · 2 of 2 declared" in reader.get(f"/tasks/{TASK}").text
    for missing in ("/labs/nobody", "/labs/", "/labs/%00"):
        assert reader.get(missing).status_code == 404


def test_addresses_of_labs_are_links_only_if_they_are_addresses(
    service: Service, reader: TestClient
) -> None:
    make = functools.partial(declared, service, new_submitter(service, "lab"))
    make(1.0, 1.4, card=Card(5, "p", "javascript:alert(1)", 2))
    work_off(service)
    page = reader.get(f"/tasks/{TASK}").text
    assert "javascript" not in page
