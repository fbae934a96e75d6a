"""The hidden half: what leaves the server, what an attempt costs, and that a reveal is proof."""

import dataclasses
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import polars as pl
import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from assistax_base.digest import leaf_sha256, merkle_root
from assistax_board.app import create_app
from assistax_board.clock import SteadyClock
from assistax_board.pages.boards import Boards
from assistax_board.pages.crossplays import CrossPlays
from assistax_board.pages.routes.organising import overview
from assistax_board.pages.season_boards import SeasonBoards
from assistax_board.problems import Problem
from assistax_board.rules import closing as closing_rules
from assistax_board.rules import seasons
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.schema import SEASON
from tests.board.fakes import (
    TASK,
    FakeFiles,
    FakeScorer,
    advance,
    close_spring,
    declared,
    draft,
    ends,
    fail_next_job,
    new_service,
    new_submitter,
    panels_of,
    scored,
    season_row,
    shown,
    state_of,
    take,
    work_off,
)
from tests.untrained import published, teams_of

SIZE = 30  # partners of each panel


def open_season(service: Service, budget: int = 3, closes_at: float | None = None) -> str:
    """Put a season of made-up partners into the database, as `create_season` would."""
    leaves = [{"seeds": {"A": "a1" * 16, "B": "b2" * 16}, "salt": "00"}]
    leaves += [
        {"ordinal": f"hidden-{i:04d}", "panel": "AB"[i % 2], "policy": f"secret-{i}", "sha256": "0"}
        for i in range(2 * SIZE)
    ]
    row = {
        "id": "season1",
        "name": "spring",
        "task": TASK,
        "state": "draft",
        "budget": budget,
        "rules": "",
        "release": service.artefacts.put(b"a packed release"),
        "secret": {"leaves": leaves},
        "panel_sizes": {"A": SIZE, "B": SIZE},
        "created_at": 0.0,
    }
    with service.database.write() as connection:
        connection.execute(sa.insert(schema.seasons).values(row))
    assert service.open_season("spring", closes_at) == merkle_root(map(leaf_sha256, leaves))
    return row["id"]


def test_a_season_from_its_opening_to_its_reveal(service: Service) -> None:
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(2.0, season=season))
    works = [take(service) for _ in range(3)]
    assert [work.panel for work in works] == ["public"] * 3
    assert service.lease("w", FakeScorer().versions()) is None, "panel A waits"
    for work in works:
        service.give_back(work.job, work.lease)
    assert work_off(service) == 3 + 2
    assert ends(service, id) == ("scored", "spent")
    panels = {score.panel: score.figures for score in service.queries.scores(submission=id)}
    assert panels.keys() == {"public", "A"}
    assert panels["A"].keys() == {"mean", "n"}
    with pytest.raises(Problem, match="is open"):
        seasons.revealed(service.database, season)
    service.close_season("spring")
    with pytest.raises(Problem, match="is closing"):
        service.withdraw(id, submitter)
    assert work_off(service) == 2
    panels = {score.panel: score.figures for score in service.queries.scores(submission=id)}
    assert panels["B"]["n"] == SIZE
    statement = seasons.revealed(service.database, season)
    assert merkle_root(map(leaf_sha256, statement["leaves"])) == statement["root"]


def test_nothing_hidden_is_in_any_answer(service: Service) -> None:
    """What anybody may read while a season runs has no ordinal, seed, salt or return."""
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(2.0, season=season))
    hidden = hidden_words(service)
    work_off(service)
    app = create_app(service)
    http = TestClient(app, raise_server_exceptions=False)
    paths = [path for path, methods in app.openapi()["paths"].items() if "get" in methods]
    assert len(paths) > 10
    texts = []
    for path in paths:
        for name in (id, season, "spring"):
            answer = http.get(path.replace("{id}", name).replace("{task}", TASK))
            texts.append(answer.text)
    assert any('"panel":"A"' in text for text in texts)
    assert any(word in '{"partner": "hidden-0007"}' for word in hidden), "a leak would be found"
    assert [word for word in hidden for text in texts if word in text] == []


def hidden_words(service: Service) -> list[str]:
    scorer = FakeScorer()
    with service.database.read() as connection:
        [secret] = connection.execute(sa.select(SEASON.secret)).scalars()
    returns = []
    service.submit(new_submitter(service, "probe"), draft(2.0, season="season1"))
    for panel in ("A", "B"):
        names = seasons.panel_partners(secret["leaves"], panel)
        work = take(service)
        seed = seasons.panel_seed(secret["leaves"], panel)
        fields = {**vars(work), "partners": tuple(names), "seed": seed}
        table = scorer.play(type(work)(**fields), b"robot 2.0", None)
        returns += [str(value) for value in table["return"].cast(pl.Float32)]
        service.give_back(work.job, work.lease)
    # Hashes hold "a1a1" by chance, and signatures the word salt.
    words = ["hidden-0", "secret-", "a1" * 4, "b2" * 4, '"salt"']
    return words + returns


def test_the_budget_is_counted_and_refunded(service: Service) -> None:
    season, submitter = open_season(service, budget=2), new_submitter(service)
    service.submit(submitter, draft(request="r1", season=season, data=b"pickle"))
    broken = scored(service, submitter, request="r2", season=season, data=b"broken")
    assert ends(service, broken) == ("refused", "refunded")
    first = service.submit(submitter, draft(1.0, "r3", season=season))
    service.submit(submitter, draft(1.0, "r4", season=season))
    with pytest.raises(Problem, match="0 of 2 attempts"):
        service.submit(submitter, draft(1.0, "r5", season=season))
    service.withdraw(first, submitter)  # before it met anybody hidden
    assert shown(service, first).attempt == "refunded"
    scored(service, submitter, 1.0, "r6", season=season)
    [attempts] = service.queries.attempts(season)
    assert (attempts.spent, attempts.reserved, attempts.left) == (2, 0, 0)


@pytest.mark.parametrize(("ends", "reason"), [("lab", "withdrawn"), ("worker", "broke_down")])
def test_own_failure_on_hidden_partners_spends_attempt(
    service: Service, ends: str, reason: str
) -> None:
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(season=season))
    work_off(service, most=3)  # the public half
    work = take(service)
    assert work.panel == "A"
    if ends == "lab":
        service.withdraw(id, submitter)
    else:
        service.job_refused(work.job, work.lease, "not_finite")
    assert (shown(service, id).reason, shown(service, id).attempt) == (reason, "spent")


def test_the_ladder_is_silent_without_an_improvement(service: Service) -> None:
    """The method whose score was shown last plays panel B, whole, if a lab chooses none."""
    season, submitter = open_season(service, budget=9), new_submitter(service)
    ids, shown_means = [], []
    for number, strength in enumerate((1.0, 1.0, 0.5, 5.0, 3.0)):
        ids.append(scored(service, submitter, strength, f"r{number}", season=season))
        advance(service, 1.0)
        scores = {s.panel: s.figures["mean"] for s in service.queries.scores(submission=ids[-1])}
        shown_means.append(scores.get("A"))
    assert shown_means[0] == pytest.approx(1.5, abs=0.2)
    assert shown_means[3] == pytest.approx(5.5, abs=0.2)
    assert shown_means[1:3] == [None, None] and shown_means[4] is None
    close_spring(service)
    assert {score.submission for score in service.queries.scores(panel="B")} == set(ids)


@pytest.mark.parametrize("by", ["its date", "the organiser"])
def test_submissions_before_close_are_played(service: Service, by: str) -> None:
    season, lab = open_season(service), new_submitter(service)
    [entry] = [e for e in service.queries.ledger() if e.kind == "season_open"]
    closes_at = service.clock() + seasons.OPEN_SECONDS
    assert season_row(service).closes_at == entry.body["closes_at"] == closes_at
    with pytest.raises(Problem, match="spring is open; expected draft"):
        service.open_season("spring")
    id = service.submit(lab, draft(season=season))
    if by == "its date":
        advance(service, seasons.OPEN_SECONDS)
    else:
        service.close_season("spring")
        assert state_of(service) == "closing"
    for late in (
        lambda: service.submit(lab, draft(request="late", season=season)),
        lambda: service.enter(season, lab, [id]),
    ):
        with pytest.raises(Problem, match=r"closing date|must be open|expected open"):
            late()
    assert work_off(service) == 3 + 2 + 2
    assert ends(service, id) == ("scored", "spent")
    assert "B" in panels_of(service, id)
    assert state_of(service) == "closed"


def test_withdrawal_closes_a_season_in_one_transaction(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kill between the two would leave a season that waits for nothing, for ever."""
    lab = new_submitter(service)
    id = service.submit(lab, draft(season=open_season(service)))
    service.close_season("spring")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(closing_rules, "take_next_step", Mock(side_effect=KeyboardInterrupt))
        service.withdraw(id, lab)
    assert (shown(service, id).state, state_of(service)) == ("queued", "closing")
    service.withdraw(id, lab)
    assert (shown(service, id).state, state_of(service)) == ("failed", "closed")


@pytest.mark.parametrize("waits_for", ["its date", "the organiser"])
def test_one_clock_jump_closes_no_season(tmp_path: Path, waits_for: str) -> None:
    """It is set far ahead and back; when it stays ahead, somebody has set it right."""
    machine = SimpleNamespace(wall=1.7e9, steady=5.0)

    def passes(seconds: float) -> None:
        machine.wall, machine.steady = machine.wall + seconds, machine.steady + seconds

    clock = SteadyClock(lambda: machine.wall, lambda: machine.steady)
    service = dataclasses.replace(new_service(tmp_path), clock=clock)
    season = open_season(service)
    if waits_for == "the organiser":
        service.submit(new_submitter(service), draft(season=season))
        service.close_season("spring")
        passes(5.0)
        fail_next_job(service)
    before = state_of(service, season)
    for jump in (seasons.OPEN_SECONDS, -seasons.OPEN_SECONDS, seasons.OPEN_SECONDS):
        machine.wall += jump
        for seconds in (0.0, 50.0):
            passes(seconds)
            assert service.lease("w", ()) is None
            assert state_of(service, season) == before != "closed"
    passes(20.0)
    assert service.lease("w", ()) is None
    assert state_of(service, season) == "closed"


def test_nobody_but_the_organiser_sees_a_draft(service: Service) -> None:
    id, token = open_season(service), service.create_token(("submit",), submitter="lab")
    with service.database.write() as connection:
        connection.execute(sa.update(schema.seasons).values(state="draft"))
    http = TestClient(create_app(service), headers={"Authorization": f"Bearer {token}"})
    for page in ("/", "/seasons", f"/tasks/{TASK}", "/submit", "/api/seasons", "/api/limits"):
        assert "spring" not in http.get(page).text
    submit = f"/api/submissions?task={TASK}&method=mine&request_id=request-1&season="
    for name in (id, "spring"):
        for path in ("", "/attempts", "/revealed", "/release"):
            assert http.get(f"/api/seasons/{name}{path}").status_code == 404
        assert http.get(f"/seasons/{name}").status_code == 404
        assert http.get(f"/api/boards/{TASK}?season={name}").status_code == 404
        assert http.post(f"/api/seasons/{name}/entries").status_code == 404
        assert http.post(submit + name, content=b"robot 1.0").status_code == 404
    assert [season.id for season in overview(service)["seasons"]] == [id]
    assert service.queries.season("spring", drafts=True) is not None


def test_a_season_says_how_long_it_is_open(tmp_path: Path) -> None:
    now = time.time()
    service = dataclasses.replace(new_service(tmp_path), clock=lambda: now)
    season = open_season(service, closes_at=now + 3 * 86_400.0 + 5 * 3_600.0 + 60.0)
    http = TestClient(create_app(service))
    assert ", in 3 days 5 hours" in " ".join(http.get(f"/seasons/{season}").text.split())


def test_two_entries_average_their_seeds(service: Service) -> None:
    season, lab = open_season(service, budget=9), new_submitter(service)
    ids = []
    for number, (method, strength) in enumerate(
        (("wide", 1.0), ("wide", 3.0), ("deep", 5.0), ("lucky", 7.0))
    ):
        fields = {"season": season, "method": method}
        ids.append(service.submit(lab, draft(strength, f"r{number}", **fields)))
    work_off(service)
    with pytest.raises(Problem, match="at most 2"):
        service.enter(season, lab, ids)
    with pytest.raises(Problem, match="you have no submission"):
        service.enter(season, new_submitter(service, "thief"), ids[:1])
    service.enter(season, lab, [ids[3]])
    service.enter(season, lab, [])
    assert not shown(service, ids[3]).entered
    service.enter("spring", lab, ids[:3])
    close_spring(service)
    on_b = {score.submission for score in service.queries.scores(panel="B")}
    assert on_b == set(ids[:3])
    rows = SeasonBoards(service.queries, service.panel_b, FakeFiles()).of(season_row(service))
    played = [(entry.newest.method, len(entry.submissions)) for _, entry in rows]
    assert played == [("deep", 1), ("wide", 2)]
    assert rows[1][0].m_test.mean == pytest.approx(2.5, abs=0.2)  # of 1.5 and 3.5


def test_season_page_shows_places_and_references(service: Service, tmp_path: Path) -> None:
    season = open_season(service)
    service.add_references()
    for lab, strength in (("ada", 2.0), ("bob", 600.0)):
        submitter = new_submitter(service, lab)
        ids = declared(service, submitter, strength, strength + 0.1, season=season)
        work_off(service)
        service.enter(season, submitter, ids)
    scored(service, new_submitter(service, "cy"), 700.0, season=season)
    reader = TestClient(create_app(service))
    revealed = f"/api/seasons/{season}/revealed", f"/api/seasons/{season}/release"
    assert not any(f'href="{link}"' in reader.get(f"/seasons/{season}").text for link in revealed)
    close_spring(service)
    page = TestClient(create_app(service)).get(f"/seasons/{season}").text
    for link in revealed:
        assert f'href="{link}"' in page
        assert reader.get(link).status_code == 200
    chosen = page[page.index("Entered for panel B") :]
    assert chosen.count(">mine</a>") == 3, "an entry of two robots stands there once"
    table = page[page.index("<h2>Panel B</h2>") : page.index("<h2>Rules</h2>")]
    for word in ("bob", "ada", "zero-action", "self-play", "Normalised", "Success", "95% interval"):
        assert word in table
    assert "2 of 2 declared" in table and "single robot" in table
    assert table.index("bob") < table.index("ada") < table.index("zero-action")
    rows = SeasonBoards(service.queries, service.panel_b, FakeFiles()).of(season_row(service))
    places = [(entry.newest.submitter, row.place) for row, entry in rows]
    assert places == [
        *(("cy", None), ("bob", 1), ("reference", None), ("ada", 2), ("reference", None))
    ]
    assert all(row.normalised is not None for row, _ in rows)
    # The season's references stay off the public board, and are not played anew.
    assert len(service.queries.submissions(season=season)) == 5 + 2
    assert new_service(tmp_path, version=2).adopt_version() == 5 + 2
    board = Boards(service.queries, CrossPlays(tmp_path), FakeFiles()).of(TASK)
    assert board is not None
    assert [len(played.submissions) for _, played in board.rows] == [1, 2, 1, 2, 1]


def test_a_scored_submission_can_be_taken_back(service: Service) -> None:
    season, lab = open_season(service), new_submitter(service)
    id = scored(service, lab, season=season)
    service.withdraw(id, lab)
    assert ends(service, id) == ("retracted", "spent")
    assert shown(service, id).reason == "withdrawn"
    assert service.queries.scores(task=TASK) == []
    assert service.queries.scores(submission=id)  # its own page still tells
    assert service.queries.receipt(id)
    assert [e.kind for e in service.queries.ledger()][-1] == "retract"
    with pytest.raises(Problem, match="has ended"):
        service.withdraw(id, lab)
    service.close_season("spring")
    assert state_of(service, season) == "closed"


@pytest.mark.parametrize("played", [1, 5], ids=["while panel A is played", "before the close"])
def test_erasure_does_not_block_season_end(service: Service, played: int) -> None:
    lab = new_submitter(service)
    service.submit(lab, draft(2.0, season=open_season(service)))
    work_off(service, most=played)
    acts = [lambda: service.close_season("spring"), lambda: service.erase_submitter(lab)]
    for act in acts if played == 1 else acts[::-1]:
        act()
    assert state_of(service) == "closed"


def test_file_shared_with_erased_lab_plays_on(service: Service) -> None:
    erased, lab = new_submitter(service, "gone"), new_submitter(service)
    scored(service, erased, 2.0, "r1")
    service.erase_submitter(erased)
    id = scored(service, lab, 2.0, "r2", season=open_season(service))
    file = shown(service, id).artefact
    assert file is not None and service.queries.is_kept(file)
    service.enter("spring", lab, [id])
    close_spring(service)
    assert [score.submission for score in service.queries.scores(panel="B")] == [id]


@pytest.mark.parametrize("played", [3, 5], ids=["panel A waits", "panel B waits"])
def test_a_closing_season_keeps_its_version(service: Service, tmp_path: Path, played: int) -> None:
    id = service.submit(new_submitter(service), draft(2.0, season=open_season(service)))
    work_off(service, most=played)
    service.close_season("spring")
    upgraded = new_service(tmp_path, version=2)
    with pytest.raises(Problem, match=r"spring is closing.*version': '1'.*now.*'2'.*start the"):
        upgraded.adopt_version()
    assert work_off(upgraded, version=2) == 0
    assert service.adopt_version() == 0
    assert work_off(service) == 7 - played
    assert panels_of(service, id) == {"public", "A", "B"}
    assert state_of(service) == "closed"
    assert upgraded.adopt_version() == 1


def test_season_closing_after_upgrade_uses_new_version(service: Service, tmp_path: Path) -> None:
    id = scored(service, new_submitter(service), 2.0, season=open_season(service))
    upgraded = new_service(tmp_path, version=2)
    advance(upgraded, 60.0)
    assert upgraded.adopt_version() == 1
    upgraded.close_season("spring")
    work_off(upgraded, version=2)
    assert "B" in panels_of(upgraded, id)
    assert state_of(upgraded) == "closed"


def test_opened_release_cannot_enter_another_season(tmp_path: Path) -> None:
    """Its partners are revealed, or will be."""
    service = new_service(tmp_path / "board")
    private = published(teams_of(3), tmp_path / "private").parent
    public: Any = SimpleNamespace(policies=())
    plans = [seasons.Plan(name, TASK, small=True) for name in ("spring", "summer", "autumn")]
    for plan in plans[:2]:
        service.create_season(plan, private, public)
    service.open_season("spring")
    with pytest.raises(Problem, match="were in season spring"):
        service.create_season(plans[2], private, public)
    for state in ("open", "closed"):
        assert state_of(service) == state
        with pytest.raises(Problem, match=r"were in season spring.*new seeds"):
            service.open_season("summer")
        if state == "open":
            service.close_season("spring")
