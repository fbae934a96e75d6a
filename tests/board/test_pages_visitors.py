"""What a visitor looks for: rows sorted and searched, a table to take away, a link that stays."""

import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.testclient import TestClient

from assistax_board.app import create_app
from tests.board.board_data import HOSTILE, VERSION, Robot, make_app
from tests.board.fakes import TASK, advance, draft, new_service, new_submitter, work_off

BOARD = "/tasks/scratch"


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    with TestClient(make_app(tmp_path_factory.mktemp("visitors"))) as client:
        yield client


def methods(page: str) -> list[str]:
    """Return the names of a board's rows, from above."""
    return re.findall(r'data-label="Method"><a [^>]+>([^<]+)</a>', page)


def test_rows_are_sorted_searched_and_filtered(client: TestClient) -> None:
    every = methods(client.get(BOARD).text)
    assert len(every) == 7
    assert methods(client.get(f"{BOARD}?sort=m_test").text) == every
    by_name = methods(client.get(f"{BOARD}?sort=method").text)
    assert by_name == sorted(every, key=str.casefold) != every
    alone = methods(client.get(f"{BOARD}?show=methods").text)
    assert alone == [
        name for name in every if name not in ("self-play", "uniform-random", "zero-action")
    ]
    page = client.get(f"{BOARD}?search=LAB&sort=seeds").text
    assert methods(page) == ["ppo ego", "sac ego"]
    assert "2 of 7 rows shown" in page
    assert methods(client.get(f"{BOARD}?sort=nonsense").text) == every
    assert client.get(f"{BOARD}?search={'x' * 81}").status_code == 422


def test_what_was_searched_for_stays_a_text(client: TestClient) -> None:
    page = client.get(BOARD, params={"search": HOSTILE[:80]}).text
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page


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


def test_a_name_is_no_formula_of_a_spreadsheet(tmp_path: Path) -> None:
    robots = (Robot("lab", '=HYPERLINK("http://x")', 500.0), Robot("@lab", "mine", 4.0))
    with TestClient(make_app(tmp_path, robots)) as reader:
        rows = list(csv.DictReader(io.StringIO(reader.get(f"{BOARD}.csv").text)))
    assert [row["method"] for row in rows] == ['\'=HYPERLINK("http://x")', "mine"]
    assert [row["submitter"] for row in rows] == ["lab", "'@lab"]


def test_a_link_with_a_version_shows_the_board_that_it_showed(tmp_path: Path) -> None:
    old = new_service(tmp_path)
    old.submit(new_submitter(old), draft(1.0, method="early"))
    work_off(old)
    [(version, _)] = old.queries.versions(TASK)
    before = TestClient(create_app(old)).get(f"/tasks/{TASK}.csv").text
    new = new_service(tmp_path, version=2)
    advance(new, 60.0)
    new.submit(new_submitter(new, "other"), draft(2.0, method="late"))
    work_off(new, version=2)
    reader = TestClient(create_app(new))
    assert methods(reader.get(f"/tasks/{TASK}").text) == ["late"]
    kept = reader.get(f"/tasks/{TASK}?version={version}").text
    assert methods(kept) == ["early"]
    assert "of an older version" in kept
    assert reader.get(f"/tasks/{TASK}.csv?version={version}").text == before
    newest = reader.get(f"/tasks/{TASK}?version={new.queries.versions(TASK)[0][0]}").text
    assert "of an older version" not in newest
    assert reader.get(f"/tasks/{TASK}?version=never").status_code == 404
