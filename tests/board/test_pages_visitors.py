"""What a visitor looks for: rows sorted and searched, a table to take away, a link that stays."""

import csv
import io
import re
import threading
from pathlib import Path
from xml.etree import ElementTree

import pytest
from starlette.testclient import TestClient

from assistax_board import pages
from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.pages import behind, boards
from assistax_board.pages.cache import PageCache
from assistax_board.problems import Problem
from assistax_board.service import Service
from assistax_board.store.database import Database
from assistax_board.store.queries import Queries
from tests.board.board_data import HOSTILE, VERSION, Robot, make_app
from tests.board.fakes import TASK, advance, draft, new_service, new_submitter, scored, work_off
from tests.board.test_pages import inline
from tests.board.test_submit_form import filled, send

BOARD = "/tasks/scratch"


def methods(page: str) -> list[str]:
    """Return the names of a board's rows, from above."""
    return re.findall(r'data-label="Method"><a [^>]+>([^<]+)</a>', page)


def test_rows_are_sorted_searched_and_filtered(client: TestClient) -> None:
    every = methods(client.get(BOARD).text)
    assert len(every) == 7
    assert methods(client.get(f"{BOARD}?sort=m_test").text) == every
    by_name = methods(client.get(f"{BOARD}?sort=method").text)
    assert by_name == sorted(every, key=str.casefold) != every
    references = {"self-play", "uniform-random", "zero-action"}
    alone = methods(client.get(f"{BOARD}?show=methods").text)
    assert alone == [name for name in every if name not in references]
    page = client.get(f"{BOARD}?search=LAB&sort=seeds").text
    assert methods(page) == ["ppo ego", "sac ego"]
    assert "2 of 7 rows match" in page
    assert methods(client.get(f"{BOARD}?sort=nonsense").text) == every
    assert client.get(f"{BOARD}?search={'x' * 81}").status_code == 422


def test_a_board_is_taken_away_as_csv(client: TestClient) -> None:
    answer = client.get(f"{BOARD}.csv")
    assert answer.headers["content-type"] == "text/csv; charset=utf-8"
    assert answer.headers["content-disposition"] == 'attachment; filename="scratch.csv"'
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    names = [row["method"] for row in rows]
    assert (names[0], names[1:3], HOSTILE in names) == ("self-play", ["ppo ego", "sac ego"], True)
    first = rows[1]
    assert (first["place"], first["lowest"], first["seeds"]) == ("1", "2", "4")
    assert float(first["m_test_low"]) < float(first["m_test"]) < float(first["m_test_high"])
    assert {row["version"] for row in rows} == {VERSION}
    assert rows[0]["place"] == "" and rows[0]["reference"] == "1"
    assert client.get(f"{BOARD}.csv?version={VERSION}").text == answer.text
    for missing in (f"{BOARD}.csv?version=none", "/tasks/nowhere.csv", "/tasks/bed_bath.csv"):
        assert client.get(missing).status_code == 404


def test_pending_board_sends_retry_after(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on, real = threading.Event(), boards.unplaced
    client = TestClient(create_app(service))
    assert client.get(f"{BOARD}.csv").status_code == 404
    id = scored(service, new_submitter(service), 1.0)
    scored(service, new_submitter(service, "other"), 2.0)
    monkeypatch.setattr(behind, "PATIENCE", 0.01)
    monkeypatch.setattr(boards, "unplaced", lambda *args: go_on.wait(60) and real(*args))
    addresses = [f"{BOARD}.csv", f"{BOARD}/heatmap", f"{BOARD}/compare"]
    addresses.append(f"/submissions/{id}/standing.json")
    for address in addresses:
        answer = client.get(address)
        assert (answer.status_code, answer.headers["Retry-After"]) == (503, "10")
        message = "the board of scratch is being computed; ask again in 10 seconds"
        assert answer.json()["error"] == {"code": "unavailable", "message": message}
        page = client.get(address, headers={"Accept": "text/html"})
        assert page.status_code == 503 and message in page.text
    for address in (BOARD, "/"):
        assert "The board is being computed" in client.get(address).text
    go_on.set()
    monkeypatch.setattr(behind, "PATIENCE", 60.0)
    assert [client.get(address).status_code for address in addresses] == [200] * 4


def test_a_name_is_no_formula_of_a_spreadsheet(tmp_path: Path) -> None:
    robots = (Robot("lab", '=HYPERLINK("http://x")', 500.0), Robot("@lab", "mine", 4.0))
    with TestClient(make_app(tmp_path, robots)) as reader:
        rows = list(csv.DictReader(io.StringIO(reader.get(f"{BOARD}.csv").text)))
    assert [row["method"] for row in rows] == ['\'=HYPERLINK("http://x")', "mine"]
    assert [row["submitter"] for row in rows] == ["lab", "'@lab"]


def test_versioned_link_shows_the_same_board(tmp_path: Path) -> None:
    old = new_service(tmp_path)
    scored(old, new_submitter(old), 1.0, method="early")
    [(version, _)] = old.queries.versions(TASK)
    before = TestClient(create_app(old)).get(f"{BOARD}.csv").text
    new = new_service(tmp_path, version=2)
    advance(new, 60.0)
    new.submit(new_submitter(new, "other"), draft(2.0, method="late"))
    work_off(new, version=2)
    reader = TestClient(create_app(new))
    assert methods(reader.get(BOARD).text) == ["late"]
    kept = reader.get(f"{BOARD}?version={version}").text
    assert methods(kept) == ["early"]
    assert "of another version" in kept
    assert reader.get(f"{BOARD}.csv?version={version}").text == before
    newest = reader.get(f"{BOARD}?version={new.queries.versions(TASK)[0][0]}").text
    assert "of another version" not in newest
    assert reader.get(f"{BOARD}?version=never").status_code == 404


def test_method_page_shows_history_and_partners(service: Service) -> None:
    lab, other = new_submitter(service), new_submitter(service, "other")
    ids = [service.submit(lab, draft(strength, f"r{strength}")) for strength in (1.0, 4.0)]
    service.submit(lab, draft(2.0, "r2", method="another idea"))
    service.submit(other, draft(3.0, "r3"))
    work_off(service)
    last = service.submit(lab, draft(5.0, "r5"))
    reader = TestClient(create_app(service))
    page = reader.get(f"/submissions/{last}/method").text
    assert "3 submissions of this name" in page
    listed = re.findall(r'<th scope="row"><a href="/submissions/(\w+)"', page)
    assert set(listed) == {*ids, last}, "of this lab and name alone"
    means = re.findall(r'<td>public</td>\s*<td class="number">([\d.]+)</td>', page)
    assert sorted(round(float(mean)) for mean in means) == [2, 4]
    assert "queued" in page
    scored = reader.get(f"/submissions/{ids[0]}/method").text
    assert "M_test of 2 seeds" in scored
    assert scored.count('class="number shade-') == 2 * 60, "two seeds with 60 partners"
    assert f'href="/submissions/{ids[0]}/method"' in reader.get(f"/submissions/{ids[0]}").text
    assert reader.get("/submissions/none/method").status_code == 404


def test_methods_and_partners_are_a_map(client: TestClient) -> None:
    page = client.get(f"{BOARD}/heatmap").text
    assert page.count('class="number shade-') == 4 * 99, "the methods that compete"
    assert "self-play" not in page
    shades = [int(shade) for shade in re.findall(r'class="number shade-(\d)"', page)]
    assert (min(shades), max(shades)) == (0, 9)
    assert page.index("ppo ego") < page.index("scripted")
    assert client.get("/tasks/bed_bath/heatmap").status_code == 404


def test_a_board_that_is_done_while_it_is_asked_for_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A reader gives up waiting, and the board is done before the page asks if it is behind."""
    of, asked = boards.Boards.of, []

    def late(self: boards.Boards, task: str, version: str | None = None) -> object:
        asked.append(task)
        return None if len(asked) == 1 else of(self, task, version)

    monkeypatch.setattr(boards.Boards, "of", late)
    with TestClient(make_app(tmp_path)) as reader:
        assert reader.get(f"{BOARD}.csv").status_code == 200


def entries(reader: TestClient, address: str = "/news.atom") -> list[dict[str, str]]:
    """Return a feed's entries, each by its elements."""
    root = ElementTree.fromstring(reader.get(address).text)
    space = "{http://www.w3.org/2005/Atom}"
    return [
        {child.tag.removeprefix(space): child.get("href") or child.text or "" for child in entry}
        for entry in root.iter(f"{space}entry")
    ]


def test_new_scores_and_seasons_are_a_feed(client: TestClient) -> None:
    answer = client.get("/news.atom")
    assert answer.headers["content-type"] == "application/atom+xml; charset=utf-8"
    news = entries(client)
    titles = [entry["title"] for entry in news]
    assert len(news) == 4 + 3 + 2 + 2 + 1, "every seed, and one season"
    assert titles[-1] == "Season Spring & <b>sun</b> of scratch opened"
    assert any(title.startswith(f"{HOSTILE} by group on scratch: 95") for title in titles)
    times = [entry["updated"] for entry in news]
    assert times == sorted(times, reverse=True)
    assert len({entry["id"] for entry in news}) == len(news)
    assert all(client.get(entry["link"]).status_code == 200 for entry in news)
    assert entries(client, "/tasks/scratch/news.atom") == news
    assert entries(client, "/tasks/bed_bath/news.atom") == []
    assert client.get("/tasks/nowhere/news.atom").status_code == 404


def test_feed_is_bounded_and_cached(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    real = Queries.scores
    monkeypatch.setattr(
        Queries, "scores", lambda self, **which: asked.append(1) or real(self, **which)
    )
    with TestClient(make_app(tmp_path, (Robot("lab", "mine", 5.0, seeds=60),))) as reader:
        news = [entries(reader) for _ in range(5)]
    assert [len(feed) for feed in news] == [50] * 5
    assert len(asked) == 1


def test_rescored_robot_keeps_its_feed_entry(tmp_path: Path) -> None:
    old = new_service(tmp_path)
    scored(old, new_submitter(old), 1.0)
    [before] = entries(TestClient(create_app(old)))
    new = new_service(tmp_path, version=2)
    advance(new, 60.0)
    new.adopt_version()
    work_off(new, version=2)
    [after] = entries(TestClient(create_app(new)))
    assert after["id"] == before["id"] and after["updated"] > before["updated"]


WORDS = {
    "about": f"Learns slowly. {HOSTILE}",
    "link": "https://example.org/a?b=1&c",
    "citation": "@misc{x,\n}",
}


def test_method_page_shows_text_link_citation(service: Service) -> None:
    """As the form and the API take them."""
    token = service.create_token(("submit",), submitter="lab")
    reader = TestClient(create_app(service), follow_redirects=False)
    form = filled(reader, token, **WORDS)
    assert send(reader, form).status_code == 303
    fields = {"task": TASK, "method": "mine", "request_id": "request-1"} | WORDS
    Client("", token, transport=reader).submit(b"robot 1.0", **fields)
    later = service.submit(new_submitter(service), draft(2.0, "r2"))
    first, *others = service.queries.submissions()
    described = [(row.about, row.link, row.citation) for row in (first, *others)]
    assert described.count(tuple(WORDS.values())) == 2
    page = reader.get(f"/submissions/{later}/method").text
    assert "Learns slowly. &lt;script&gt;" in page and "<script>alert" not in page
    assert 'href="https://example.org/a?b=1&amp;c" rel="nofollow' in page
    assert "@misc{x,\n}" in page
    assert inline(page) == []
    service.erase_submitter(new_submitter(service))
    id = first.id
    assert reader.get(f"/api/submissions/{id}").json()["about"] is None
    assert "slowly" not in TestClient(create_app(service)).get(f"/submissions/{id}/method").text


@pytest.mark.parametrize(
    "words",
    [
        {"about": "x" * 601},
        {"about": "\x1b[2J"},
        {"link": "javascript:alert(1)"},
        {"link": "https://example.org/a b"},
        {"link": "https://" + "x" * 200},
        {"citation": "x" * 1001},
    ],
)
def test_what_is_said_of_a_method_is_bounded(service: Service, words: dict[str, str]) -> None:
    with pytest.raises(Problem, match=r"at most|begins with"):
        service.submit(new_submitter(service), draft(1.0, **words))
    assert service.queries.submissions() == []


def test_readers_do_not_ask_the_database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever reads the same page in the same second gets the same bytes."""
    monkeypatch.setattr(pages, "PageCache", lambda: PageCache(lambda: 0.0))
    reads: list[int] = []
    real = Database.read
    monkeypatch.setattr(Database, "read", lambda self: reads.append(1) or real(self))
    with TestClient(make_app(tmp_path)) as reader:
        [first, *_] = re.findall(r'href="(/submissions/\w+)"', reader.get(BOARD).text)
        addresses = (f"{BOARD}?search=ego", f"{BOARD}.csv", f"{BOARD}/heatmap", f"{first}/method")
        for address in addresses:
            reader.get(address)
        asked = len(reads)
        assert asked
        for address in addresses * 3:
            assert reader.get(address).status_code == 200
    assert len(reads) == asked
