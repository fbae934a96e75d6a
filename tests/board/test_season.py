"""The hidden half: what leaves the server, what an attempt costs, and that a reveal is proof."""

import dataclasses
import json
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

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
from assistax_board.rules import jobs, seasons
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.schema import SEASON
from tests.board.fakes import (
    TASK,
    FakeScorer,
    advance,
    draft,
    new_service,
    new_submitter,
    shown,
    take,
    work_off,
)
from tests.board.running import served
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


def test_a_season_from_its_opening_to_its_reveal(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(2.0, season=season))
    assert work_off(service) == 3 + 2
    assert (shown(service, id).state, shown(service, id).attempt) == ("scored", "spent")
    panels = {score.panel: score.figures for score in service.queries.scores(submission=id)}
    assert panels.keys() == {"public", "A"}
    assert panels["A"].keys() == {"mean", "n"}
    with pytest.raises(Problem, match="is open"):
        seasons.revealed(service.database, season)
    service.close_season("spring")
    assert work_off(service) == 2
    panels = {score.panel: score.figures for score in service.queries.scores(submission=id)}
    assert panels["B"]["n"] == SIZE
    statement = seasons.revealed(service.database, season)
    assert merkle_root(map(leaf_sha256, statement["leaves"])) == statement["root"]


def test_nothing_hidden_is_in_any_answer(tmp_path: Path) -> None:
    """What anybody may read while a season runs has no ordinal, seed, salt or return."""
    service = new_service(tmp_path)
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
    assert [word for word in hidden for text in texts if word in text] == []


def test_a_planted_leak_is_found(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    open_season(service)
    assert any(word in json.dumps({"partner": "hidden-0007"}) for word in hidden_words(service))


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


def test_the_budget_is_counted_and_refunded(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service, budget=2), new_submitter(service)
    first = service.submit(submitter, draft(1.0, "r1", season=season))
    service.submit(submitter, draft(1.0, "r2", season=season))
    with pytest.raises(Problem, match="all 2 attempts"):
        service.submit(submitter, draft(1.0, "r3", season=season))
    service.withdraw(first, submitter)  # before it met anybody hidden
    assert shown(service, first).attempt == "refunded"
    service.submit(submitter, draft(1.0, "r4", season=season))
    work_off(service)
    [attempts] = service.queries.attempts(season)
    assert (attempts.spent, attempts.reserved, attempts.left) == (2, 0, 0)


def test_a_refused_file_costs_no_attempt(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service, budget=1), new_submitter(service)
    service.submit(submitter, draft(request="r1", season=season, data=b"pickle"))
    id = service.submit(submitter, draft(request="r2", season=season, data=b"broken"))
    work_off(service)
    assert (shown(service, id).state, shown(service, id).attempt) == ("refused", "refunded")
    service.submit(submitter, draft(request="r3", season=season))


def test_withdrawal_after_hidden_partners_spends_attempt(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(season=season))
    work_off(service, most=3)  # the public half
    assert take(service).panel == "A"
    service.withdraw(id, submitter)
    assert (shown(service, id).reason, shown(service, id).attempt) == ("withdrawn", "spent")


def test_breakdown_on_hidden_partners_spends_attempt(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(season=season))
    work_off(service, most=3)
    work = take(service)
    service.job_refused(work.job, work.lease, "not_finite")
    assert (shown(service, id).reason, shown(service, id).attempt) == ("broke_down", "spent")


def test_hidden_panel_waits_for_public_panel(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    service.submit(new_submitter(service), draft(season=season))
    held = [take(service).panel for _ in range(3)]
    assert held == ["public"] * 3
    assert service.lease("w", FakeScorer().versions()) is None


def test_the_ladder_is_silent_without_an_improvement(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service, budget=9), new_submitter(service)
    shown_means = []
    for number, strength in enumerate((1.0, 1.0, 0.5, 5.0)):
        id = service.submit(submitter, draft(strength, f"r{number}", season=season))
        work_off(service)
        advance(service, 1.0)
        scores = {s.panel: s.figures["mean"] for s in service.queries.scores(submission=id)}
        shown_means.append(scores.get("A"))
    assert shown_means[0] == pytest.approx(1.5, abs=0.2)
    assert shown_means[1:3] == [None, None]
    assert shown_means[3] == pytest.approx(5.5, abs=0.2)


def test_submissions_before_close_are_played(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    id = service.submit(new_submitter(service), draft(season=season))
    service.close_season("spring")
    with pytest.raises(Problem, match="it must be open"):
        service.submit(new_submitter(service), draft(request="late", season=season))
    assert state_of(service, season) == "closing"
    assert work_off(service) == 3 + 2 + 2
    assert (shown(service, id).state, shown(service, id).attempt) == ("scored", "spent")
    assert "B" in {score.panel for score in service.queries.scores(submission=id)}
    assert state_of(service, season) == "closed"


def test_a_season_without_a_robot_closes_at_once(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    service.close_season("spring")
    assert state_of(service, season) == "closed"


def test_withdrawal_of_last_submission_advances_season(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service), new_submitter(service)
    id = service.submit(submitter, draft(season=season))
    service.close_season("spring")
    service.withdraw(id, submitter)
    assert state_of(service, season) == "closed"


def test_a_season_closes_by_itself_at_its_date(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, submitter = open_season(service), new_submitter(service)
    opened = service.queries.season(season)
    assert opened is not None
    assert opened.closes_at == service.clock() + seasons.OPEN_SECONDS
    [entry] = [e for e in service.queries.ledger() if e.kind == "season_open"]
    assert entry.body["closes_at"] == opened.closes_at
    id = service.submit(submitter, draft(season=season))
    advance(service, seasons.OPEN_SECONDS)
    for late in (
        lambda: service.submit(submitter, draft(request="late", season=season)),
        lambda: service.enter(season, submitter, [id]),
    ):
        with pytest.raises(Problem, match="closing date"):
            late()
    assert work_off(service) == 3 + 2 + 2
    assert state_of(service, season) == "closed"


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
        for _ in range(jobs.MAX_FAILURES):
            work = take(service)
            service.job_failed(work.job, work.lease)
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


def test_nobody_but_the_organiser_sees_a_draft(tmp_path: Path) -> None:
    service = new_service(tmp_path)
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


def test_a_closing_date_is_ahead(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    with pytest.raises(Problem, match="within three years"):
        service.open_season("spring", service.clock() - 1)


def test_two_entries_average_their_seeds(tmp_path: Path) -> None:
    service = new_service(tmp_path)
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
    service.enter("spring", lab, ids[:3])
    service.close_season("spring")
    work_off(service)
    on_b = {score.submission for score in service.queries.scores(panel="B")}
    assert on_b == set(ids[:3])
    boards = SeasonBoards(service.queries, service.panel_b)
    closed = service.queries.season(season)
    assert closed is not None
    rows = boards.of(closed)
    assert [(entry.newest.method, len(entry.submissions)) for _, entry in rows] == [
        ("deep", 1),
        ("wide", 2),
    ]
    assert rows[1][0].m_test.mean == pytest.approx(2.5, abs=0.2)  # of 1.5 and 3.5


def test_last_shown_submission_is_default_entry(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, lab = open_season(service, budget=9), new_submitter(service)
    ids = []
    for number, strength in enumerate((1.0, 5.0, 3.0)):
        ids.append(service.submit(lab, draft(strength, f"r{number}", season=season)))
        work_off(service)
        advance(service, 1.0)
    service.close_season("spring")
    work_off(service)
    assert {score.submission for score in service.queries.scores(panel="B")} == {ids[1]}


def test_season_page_shows_places_and_references(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    service.add_references()
    for lab, strength in (("ada", 2.0), ("bob", 6.0)):
        service.submit(new_submitter(service, lab), draft(strength, season=season))
    work_off(service)
    service.close_season("spring")
    work_off(service)
    page = TestClient(create_app(service)).get(f"/seasons/{season}").text
    table = page[page.index("<h2>Panel B</h2>") : page.index("<h2>Panel A</h2>")]
    for word in ("bob", "ada", "zero-action", "self-play", "Normalised", "Success", "95% interval"):
        assert word in table
    assert table.index("bob") < table.index("ada") < table.index("zero-action")
    closed = service.queries.season(season)
    assert closed is not None
    rows = SeasonBoards(service.queries, service.panel_b).of(closed)
    assert [(entry.newest.submitter, row.place) for row, entry in rows] == [
        ("reference", None),
        ("bob", 1),
        ("ada", 2),
        ("reference", None),
    ]
    assert all(row.normalised is not None for row, _ in rows)


def test_a_scored_submission_can_be_taken_back(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, lab = open_season(service), new_submitter(service)
    id = service.submit(lab, draft(season=season))
    work_off(service)
    service.withdraw(id, lab)
    submission = shown(service, id)
    assert (submission.state, submission.reason, submission.attempt) == (
        "retracted",
        "withdrawn",
        "spent",
    )
    assert service.queries.scores(task=TASK) == []
    assert service.queries.scores(submission=id)  # its own page still tells
    assert service.queries.receipt(id)
    assert [e.kind for e in service.queries.ledger()][-1] == "retract"
    with pytest.raises(Problem, match="has ended"):
        service.withdraw(id, lab)
    service.close_season("spring")
    assert state_of(service, season) == "closed"


def test_nobody_leaves_while_panel_b_is_played(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season, lab = open_season(service), new_submitter(service)
    id = service.submit(lab, draft(season=season))
    work_off(service)
    service.close_season("spring")
    with pytest.raises(Problem, match="is closing"):
        service.withdraw(id, lab)


def state_of(service: Service, season: str) -> str:
    season_row = service.queries.season(season)
    assert season_row is not None
    return season_row.state


def test_another_root_proves_nothing(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    service.close_season("spring")
    statement = seasons.revealed(service.database, season)
    statement["leaves"][3]["panel"] = "B"
    with pytest.raises(ValueError, match="not those whose root"):
        seasons.verify_season(statement, b"", statement["root"], tmp_path)


def closing(folder: Path) -> tuple[Service, str]:
    """Return a service whose season is closing: panel B waits."""
    service = new_service(folder)
    season = open_season(service)
    id = service.submit(new_submitter(service), draft(2.0, season=season))
    work_off(service)
    service.close_season("spring")
    return service, id


def state_of_season(service: Service) -> str:
    season = service.queries.season("spring")
    assert season is not None
    return season.state


@pytest.mark.parametrize("played", [1, 5], ids=["while panel A is played", "before the close"])
def test_erasure_does_not_block_season_end(tmp_path: Path, played: int) -> None:
    service = new_service(tmp_path)
    season, lab = open_season(service), new_submitter(service)
    id = service.submit(lab, draft(2.0, season=season))
    work_off(service, most=played)
    if played == 1:
        service.close_season("spring")
        service.erase_submitter(lab)
    else:
        assert shown(service, id).state == "scored"
        service.erase_submitter(lab)
        service.close_season("spring")
    assert state_of_season(service) == "closed"


def test_file_shared_with_erased_lab_plays_on(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    erased, lab = new_submitter(service, "gone"), new_submitter(service)
    service.submit(erased, draft(2.0, "r1"))
    work_off(service)
    service.erase_submitter(erased)
    id = service.submit(lab, draft(2.0, "r2", season=open_season(service)))
    work_off(service)
    file = shown(service, id).artefact
    assert file is not None and service.queries.is_kept(file)
    service.enter("spring", lab, [id])
    service.close_season("spring")
    work_off(service)
    assert [score.submission for score in service.queries.scores(panel="B")] == [id]


def test_a_closing_season_keeps_its_version(tmp_path: Path) -> None:
    service, id = closing(tmp_path)
    upgraded = new_service(tmp_path, version=2)
    with pytest.raises(Problem, match=r"spring is closing.*version': '1'.*now.*'2'.*start the"):
        upgraded.adopt_version()
    assert work_off(upgraded, version=2) == 0
    assert service.adopt_version() == 0
    assert work_off(service) == 2
    assert "B" in {score.panel for score in service.queries.scores(submission=id)}
    assert state_of_season(service) == "closed"
    assert upgraded.adopt_version() == 1


def test_closing_season_keeps_version_during_panel_a(tmp_path: Path) -> None:
    """What was handed in in time would lose panel A, which no closing season plans anew."""
    service = new_service(tmp_path)
    season = open_season(service)
    id = service.submit(new_submitter(service), draft(2.0, season=season))
    work_off(service, most=3)  # its public half: panel A waits
    service.close_season("spring")
    upgraded = new_service(tmp_path, version=2)
    with pytest.raises(Problem, match="spring is closing"):
        upgraded.adopt_version()
    work_off(service)
    assert {score.panel for score in service.queries.scores(submission=id)} == {"public", "A", "B"}
    assert state_of_season(service) == "closed"


def test_season_closing_after_upgrade_uses_new_version(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    id = service.submit(new_submitter(service), draft(2.0, season=season))
    work_off(service)
    upgraded = new_service(tmp_path, version=2)
    advance(upgraded, 60.0)
    assert upgraded.adopt_version() == 1
    upgraded.close_season("spring")
    work_off(upgraded, version=2)
    assert "B" in {score.panel for score in upgraded.queries.scores(submission=id)}
    assert state_of_season(upgraded) == "closed"


def test_opened_release_cannot_enter_another_season(tmp_path: Path) -> None:
    """Its partners are revealed, or will be."""
    service = new_service(tmp_path)
    season = open_season(service)
    with service.database.write() as connection:
        row = connection.execute(sa.select(schema.seasons)).mappings().one()
        again = {"id": "season2", "name": "summer", "state": "draft", "root": None}
        connection.execute(sa.insert(schema.seasons).values({**row, **again}))
    for _ in range(2):
        with pytest.raises(Problem, match=r"were in season spring.*new seeds"):
            service.open_season("summer")
        service.close_season("spring") if state_of_season(service) == "open" else None
    assert seasons.revealed(service.database, season)["root"]


def test_season_of_used_release_is_refused(tmp_path: Path) -> None:
    service = new_service(tmp_path / "board")
    private = published(teams_of(3), tmp_path / "private").parent
    public: Any = SimpleNamespace(policies=())
    plan = seasons.Plan("spring", TASK, small=True)
    service.create_season(plan, private, public)
    service.create_season(dataclasses.replace(plan, name="a draft is none"), private, public)
    service.open_season("spring")
    with pytest.raises(Problem, match="were in season spring"):
        service.create_season(dataclasses.replace(plan, name="summer"), private, public)


def test_entries_are_chosen_over_the_network(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    with served(service) as server:
        client = server.client("submit")
        fields = {"task": TASK, "method": "mine", "season": season}
        id = client.submit(b"robot 2.0", request_id="request-1", **fields)["id"]
        assert [entry["id"] for entry in client.enter("spring", [id])] == [id]
        assert shown(service, id).entered
        assert client.enter(season, []) == []
        assert not shown(service, id).entered
        other = server.client("submit", "another lab")
        with pytest.raises(Problem, match="you have no submission"):
            other.enter(season, [id])


def test_season_references_stay_off_public_board(tmp_path: Path) -> None:
    service = new_service(tmp_path)
    season = open_season(service)
    service.add_references()
    service.submit(new_submitter(service), draft(2.0, season=season))
    work_off(service)
    service.close_season("spring")
    work_off(service)
    assert len(service.queries.submissions(season=season)) == 1 + 2
    assert new_service(tmp_path, version=2).adopt_version() == 1 + 2  # the file, public references
    boards = Boards(service.queries, CrossPlays(tmp_path))
    board = boards.of(TASK)
    assert board is not None
    assert [len(played.submissions) for _, played in board.rows] == [1, 1, 1]
