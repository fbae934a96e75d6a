"""Pages whose addresses readers make: few at once, few for one address, and none reads too much."""

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from assistax_board.pages import boards, cache
from assistax_board.pages.cache import PageCache
from assistax_board.pages.crossplays import CrossPlays
from assistax_board.problems import Problem
from assistax_board.service import Service
from assistax_board.store.queries import Queries
from tests.board.board_data import make_app
from tests.board.fakes import TASK, FakeFiles, declared, new_submitter, scored, work_off


def test_few_limited_pages_are_made_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "PATIENCE", 0.01)
    go_on, busy, pages = threading.Event(), threading.Barrier(3), PageCache()

    def slow() -> str:
        busy.wait(60)
        assert go_on.wait(60)
        return "slow"

    with ThreadPoolExecutor(2) as pool:
        making = [pool.submit(pages.page, key, 60.0, slow, limited=True) for key in ("one", "two")]
        busy.wait(60)
        with pytest.raises(Problem, match="many pages are being made"):
            pages.page("three", 60.0, lambda: "x", limited=True)
        assert pages.page("board", 60.0, lambda: "x").body == b"x"
        go_on.set()
        assert [page.result().body for page in making] == [b"slow"] * 2
    assert pages.page("three", 60.0, lambda: "x", limited=True).body == b"x"


def test_one_address_gets_few_pages_that_are_new(tmp_path: Path, one_window: None) -> None:
    with TestClient(make_app(tmp_path)) as client:
        answers = [client.get(f"/tasks/scratch?search={i}").status_code for i in range(121)]
        assert answers == [200] * 120 + [429]
        assert client.get("/tasks/scratch?search=1").status_code == 200
        assert client.get("/tasks/scratch").status_code == 200


def test_an_unchanged_board_reads_no_submissions(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = new_submitter(service)
    declared(service, lab, 1.0, 2.0)
    work_off(service)
    kept = boards.Boards(service.queries, CrossPlays(Path("none")), FakeFiles())
    first = kept.of(TASK)
    read: list[str] = []
    real = Queries.submissions
    monkeypatch.setattr(
        Queries,
        "submissions",
        lambda self, **fields: read.append(TASK) or real(self, **fields),
    )
    assert kept.of(TASK) is first and read == []
    single = scored(service, lab, 3.0, "r3", method="single")
    assert kept.of(TASK) is not first and read == [TASK]
    service.withdraw(single, lab)
    again = kept.of(TASK)
    assert again is not None and again.singles == ()
    service.erase_submitter(lab)
    erased = kept.of(TASK)
    assert erased is not None
    assert erased.rows[0][1].newest.submitter.startswith("erased")
