"""The form of the web page: answered to who was given it, and to the owner of a token."""

import contextlib
import re
from collections.abc import Iterator
from typing import Any

import pytest
from starlette.testclient import TestClient

from assistax_board.api.desk import FORMS, Desk
from assistax_board.app import create_app
from assistax_board.pages.security import FIELD
from assistax_board.problems import Problem
from assistax_board.service import Service
from tests.board.fakes import work_off
from tests.board.test_season import open_season


@pytest.fixture
def reader(service: Service) -> Iterator[TestClient]:
    with TestClient(create_app(service), follow_redirects=False) as client:
        yield client


def filled(reader: TestClient, token: str, **changed: str) -> dict[str, str]:
    """Return the fields of a form that was just loaded."""
    text = reader.get("/submit").text
    hidden = dict(re.findall(r'type="hidden" name="(\w+)" value="(\w+)"', text))
    fields = {"task": "scratch", "method": "mine", "licence": "MIT", "account_token": token}
    return hidden | fields | changed


def send(
    reader: TestClient, fields: dict[str, str], data: bytes = b"robot 1.0", **more: Any
) -> Any:
    return reader.post("/submit", data=fields, files={"file": ("robot.onnx", data)}, **more)


@pytest.fixture
def token(service: Service) -> str:
    return service.create_token(("submit",), submitter="lab")


def test_a_form_sent_twice_is_one_submission(
    service: Service, reader: TestClient, token: str
) -> None:
    form = filled(reader, token)
    answers = [send(reader, form) for _ in range(2)]
    [submission] = service.queries.submissions()
    assert {a.headers["location"] for a in answers} == {f"/submissions/{submission.id}"}
    assert (answers[0].status_code, submission.method, submission.licence) == (303, "mine", "MIT")
    assert send(reader, filled(reader, token)).status_code == 303
    assert len(service.queries.submissions()) == 2


@pytest.mark.parametrize(
    ("changed", "data", "status", "message"),
    [
        ({"account_token": "azt_wrong"}, b"robot 1.0", 401, "this token is not valid"),
        ({"account_token": ""}, b"robot 1.0", 401, "send a token"),
        ({"task": "dance"}, b"robot 1.0", 422, "allowed are scratch"),
        ({"licence": "mine alone"}, b"robot 1.0", 422, "allowed are Apache-2.0"),
        ({"method": " "}, b"robot 1.0", 422, "method has 1 to 80"),
        ({"season": "never"}, b"robot 1.0", 404, "no season"),
        ({"request_id": ""}, b"robot 1.0", 422, "request has 1 to 64"),
        ({}, b"", 422, "not empty"),
    ],
)
def test_invalid_form_returns_with_reason(
    service: Service,
    reader: TestClient,
    token: str,
    changed: Any,
    data: bytes,
    status: int,
    message: str,
) -> None:
    answer = send(reader, filled(reader, token) | changed, data)
    assert answer.status_code == status and message in answer.text
    assert token not in answer.text and "azt_wrong" not in answer.text
    worker = service.create_token(("work",))
    assert send(reader, filled(reader, worker)).status_code == 403
    assert service.queries.submissions() == []


CARD = {"steps": "1,000,000", "trained": "5", "partners": "train side", "code": "not published"}


def send_all(reader: TestClient, fields: dict[str, str], *robots: bytes) -> Any:
    """Send a form with several files."""
    files = [("file", (f"robot{n}.onnx", data)) for n, data in enumerate(robots)]
    return reader.post("/submit", data=fields, files=files)


def test_several_files_are_a_declared_entry(
    service: Service, reader: TestClient, token: str
) -> None:
    form, robots = filled(reader, token, **CARD), (b"robot 1.0", b"robot 2.0", b"robot 3.0")
    assert all(f'name="{name}"' in reader.get("/submit").text for name in CARD)
    answers = [send_all(reader, form, *robots) for _ in range(2)]
    assert {answer.status_code for answer in answers} == {303}
    rows = service.queries.submissions()
    assert len(rows) == 3, "a form sent twice is one entry"
    assert {answer.headers["location"] for answer in answers} <= {
        f"/submissions/{row.id}" for row in rows
    }
    assert len({row.entry for row in rows}) == 1
    card = {"steps": 1_000_000, "trained": 5, "partners": "train side", "code": "not published"}
    assert [(row.declared, row.card) for row in rows] == [(3, card)] * 3
    assert work_off(service) > 0
    page = reader.get(answers[0].headers["location"]).text
    assert "Its entry, as the lab says" in page and "train side" in page
    assert "3 of 3 declared" in reader.get("/tasks/scratch").text


@pytest.mark.parametrize(
    ("changed", "robots", "message"),
    [
        ({}, 1, "there is 1 file and a card; an entry has 2 to 10 files"),
        ({"steps": "many"}, 2, "steps is &#39;many&#39;; the card of an entry of 2 files needs"),
        ({"steps": "", "trained": "", "partners": "", "code": ""}, 2, "steps is &#39;&#39;"),
        ({"trained": "1"}, 2, "trained is 1 and there are 2 files"),
        ({"code": ""}, 2, "code has 1 to 200"),
        ({"season": "never"}, 2, "no season"),
        ({"method": "x" * 81}, 2, "method has 1 to 80"),
        ({}, 11, "more than 10 files"),
    ],
)
def test_an_entry_with_a_mistake_comes_back(
    service: Service, reader: TestClient, token: str, changed: Any, robots: int, message: str
) -> None:
    files = [f"robot {n}.0".encode() for n in range(robots)]
    answer = send_all(reader, filled(reader, token, **CARD) | changed, *files)
    assert answer.status_code in (404, 422) and message in answer.text
    assert service.queries.submissions() == []
    if robots <= 10:
        assert f'value="{changed.get("partners", "train side")}"' in answer.text


def test_a_refused_seed_ends_its_entry(service: Service, reader: TestClient, token: str) -> None:
    form = filled(reader, token, **CARD)
    answer = send_all(reader, form, b"robot 1.0", b"no robot", b"robot 3.0")
    page = reader.get(answer.headers["location"]).text
    assert "the file is neither" in page
    assert {row.state for row in service.queries.submissions()} == {"refused", "failed"}
    assert work_off(service) == 0
    same = send_all(reader, filled(reader, token, **CARD), b"robot 1.0", b"robot 1.0")
    assert same.status_code == 422 and "two files are the same" in same.text
    empty = send_all(reader, filled(reader, token, **CARD), b"robot 1.0", b"")
    assert empty.status_code == 422 and "not empty" in empty.text


def test_an_entry_goes_on_where_it_was_interrupted(
    service: Service, reader: TestClient, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The board is busy after the first file: the same form, sent again, completes the entry."""
    form, calls = filled(reader, token, **CARD), []
    submit = Service.submit

    def busy(self: Service, submitter: str, draft: Any) -> str:
        calls.append(draft)
        if len(calls) == 2:
            raise Problem("unavailable", "many robots are being handed in; try again soon", 5)
        return submit(self, submitter, draft)

    monkeypatch.setattr(Service, "submit", busy)
    answer = send_all(reader, form, b"robot 1.0", b"robot 2.0")
    assert answer.status_code == 503 and "was not handed in whole" in answer.text
    assert f'name="request_id" value="{form["request_id"]}"' in answer.text
    assert send_all(reader, form, b"robot 1.0", b"robot 2.0").status_code == 303
    rows = service.queries.submissions()
    assert len(rows) == 2 and len({row.entry for row in rows}) == 1
    assert {row.place is not None for row in rows} == {True}, "it is whole, and waits"


def test_foreign_form_is_refused(service: Service, reader: TestClient, token: str) -> None:
    form = filled(reader, token)
    elsewhere = {"Sec-Fetch-Site": "cross-site"}
    assert send(reader, form, headers=elsewhere).status_code == 403
    assert send(reader, form | {FIELD: "0" * 64}).status_code == 403
    reader.cookies.clear()
    assert send(reader, form).status_code == 403
    assert service.queries.submissions() == []


@pytest.mark.usefixtures("one_window")
def test_a_form_outlives_a_restart(service: Service, reader: TestClient) -> None:
    form = filled(reader, "azt_wrong")
    with TestClient(create_app(service), cookies=reader.cookies) as after:
        assert send(after, form).status_code == 401  # the token is wrong; the form is right


def test_tokens_cannot_be_guessed_by_the_form(reader: TestClient) -> None:
    form = filled(reader, "azt_guess")
    codes = [send(reader, form).status_code for _ in range(32)]
    assert codes[0] == 401 and codes[-1] == 429


def test_a_form_from_elsewhere_is_not_read(reader: TestClient) -> None:
    """Without the cookie of a page of ours nothing of it is parsed."""
    wrong = {"Content-Type": "multipart/form-data; boundary=x"}
    assert reader.post("/submit", content=b"no form", headers=wrong).status_code == 403
    reader.get("/submit")
    assert reader.post("/submit", content=b"no form", headers=wrong).status_code == 422


@pytest.mark.usefixtures("one_window")
def test_file_forms_are_rate_limited(
    reader: TestClient, token: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    form = filled(reader, token)
    with monkeypatch.context() as patch:
        patch.setattr("assistax_board.api.desk.FORMS", 0)
        assert send(reader, form).status_code == 503
    assert [send(reader, form).status_code for _ in range(22)][-1] == 429


def test_one_address_sends_one_form_at_a_time() -> None:
    desk = Desk()
    with desk.form("192.0.2.1"), desk.form("192.0.2.2"):
        with pytest.raises(Problem, match="many forms"), desk.form("192.0.2.1"):
            pass
        with pytest.raises(Problem, match="many forms"), contextlib.ExitStack() as stack:
            for number in range(FORMS):
                stack.enter_context(desk.form(f"198.51.100.{number}"))
    with desk.form("192.0.2.1"):
        pass


def test_limits_button_submits_nothing(service: Service, reader: TestClient, token: str) -> None:
    open_season(service, budget=3)
    answer = send(reader, filled(reader, token) | {"limits": "show"})
    assert answer.status_code == 200
    assert "3 of 3 attempts left" in answer.text
    assert "60 of 60 requests left" in answer.text
    assert token not in answer.text
    assert service.queries.submissions() == []
    assert 'value="mine"' in answer.text, "the form is as it was filled in"
    wrong = send(reader, filled(reader, "azt_wrong") | {"limits": "show"})
    assert (wrong.status_code, "attempts left" in wrong.text) == (401, False)
