"""The API from outside: who may do what, what is refused, and a submission from end to end."""

import html
import logging
import re
from pathlib import Path
from types import SimpleNamespace

import httpx2
import pytest
from limits import parse
from starlette.testclient import TestClient

from assistax_board.api.guards import MAX_BODY, MOST_BODY
from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.problems import Problem
from assistax_board.rules.tokens import list_tokens, revoke_token
from assistax_board.service import Service
from assistax_board.work.worker import Worker
from tests.board.fakes import TASK, FakeScorer, draft, new_submitter, scored
from tests.board.test_season import open_season
from tests.test_layers import heavy_imports

FIELDS = {"task": TASK, "method": "mine", "request_id": "request-1"}


@pytest.fixture
def http(service: Service) -> TestClient:
    return TestClient(create_app(service), raise_server_exceptions=False)


def client_of(service: Service, http: TestClient, scope: str) -> Client:
    submitter = "lab" if scope == "submit" else None
    return Client("", service.create_token((scope,), submitter=submitter), transport=http)


def bearer(service: Service, scope: str) -> dict[str, str]:
    """Return the headers that bear a new token."""
    submitter = "lab" if scope == "submit" else None
    return {"Authorization": f"Bearer {service.create_token((scope,), submitter=submitter)}"}


def test_a_submission_from_end_to_end(service: Service, http: TestClient) -> None:
    submitter = client_of(service, http, "submit")
    id = submitter.submit(b"robot 3.0", **FIELDS)["id"]
    waiting = http.get("/metrics").text
    assert 'assistax_service_jobs{state="waiting"} 3.0' in waiting
    assert 'assistax_service_submissions{state="queued"} 1.0' in waiting
    assert Worker(client_of(service, http, "work"), FakeScorer()).run(until_empty=True) == 3
    assert submitter.submission(id)["state"] == "scored"
    [score] = submitter.scores(id)
    assert 3.0 < score["figures"]["mean"] < 4.0
    board = http.get(f"/api/boards/{TASK}").json()
    assert board["scores"] == [score]
    assert "not validated" in board["statement"]
    assert submitter.receipt(id)["content"]["submission"] == id


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/api/submissions?task=scratch&method=m&request_id=12345678"),
        ("POST", "/api/work/lease"),
        ("GET", f"/api/work/artefacts/{'0' * 64}"),
        ("PUT", "/api/work/x/result?seconds=1"),
    ],
)
def test_a_token_does_only_what_it_is_for(
    service: Service, http: TestClient, method: str, path: str
) -> None:
    wrong = {"Authorization": "Bearer azt_wrong"}
    for headers, status in (({}, 401), (wrong, 401), (bearer(service, "organise"), 403)):
        assert http.request(method, path, headers=headers).status_code == status


def test_a_token_is_kept_hashed_and_revoked(
    service: Service, http: TestClient, tmp_path: Path
) -> None:
    headers, body = bearer(service, "work"), {"worker": "w", "versions": []}
    token = headers["Authorization"].split()[1]
    assert http.post(f"/api/work/lease?token={token}", json=body).status_code == 401
    assert http.post("/api/work/lease", json=body, headers=headers).status_code == 204
    service.database.close()
    assert token.encode() not in (tmp_path / "service.db").read_bytes()
    with service.begin() as transaction:
        revoke_token(transaction, list_tokens(service.database)[0].id)
    assert http.post("/api/work/lease", json=body, headers=headers).status_code == 401


def test_body_without_size_is_cut_off(service: Service, http: TestClient) -> None:
    endless = (bytes(1024 * 1024) for _ in range(20))
    words = {"params": FIELDS, "headers": bearer(service, "submit"), "content": endless}
    assert http.post("/api/submissions", **words).status_code >= 400
    assert service.queries.submissions() == []


def test_an_unexpected_error_tells_nothing(
    service: Service, http: TestClient, monkeypatch, caplog
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("hidden-0007 returned 8.125e+02")

    monkeypatch.setattr("assistax_board.store.queries.Queries.submissions", broken)
    with caplog.at_level(logging.INFO, logger="assistax_board"):
        answer = http.get("/api/submissions")
    assert (answer.status_code, answer.json()["error"]["code"]) == (500, "unexpected")
    assert "8.125e+02" not in answer.text + caplog.text + repr([vars(r) for r in caplog.records])


def test_logs_hold_no_secrets(service: Service, http: TestClient, caplog) -> None:
    headers = bearer(service, "submit")
    with caplog.at_level(logging.INFO, logger="assistax_board"):
        http.post("/api/submissions", params=FIELDS, headers=headers, content=b"robot 1.0")
    [record] = [r for r in caplog.records if r.name == "assistax_board"]
    assert record.fields["route"] == "/api/submissions"
    assert headers["Authorization"].split()[1] not in repr(vars(record))
    assert "robot 1.0" not in repr(vars(record))


def test_unknown_http_methods_count_as_one(
    http: TestClient, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, logger="assistax_board"):
        for method in ("MINT", "X" * 60_000):
            assert http.request(method, "/nowhere").status_code == 404
            assert http.request(method, f"/api/boards/{TASK}").status_code == 405
    assert http.get("/api/health").json() == {"status": "ok"}
    text = http.get("/metrics").text
    assert 'requests_total{method="other",route="none",status="404"} 2.0' in text
    assert not re.search("MINT|XXX", text + repr([vars(record) for record in caplog.records]))


@pytest.mark.usefixtures("one_window")
@pytest.mark.parametrize("path", ["/nowhere", "/metrics", "/api/nowhere"])
def test_what_no_page_answers_is_limited_too(
    http: TestClient, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    monkeypatch.setattr("assistax_board.api.guards.READ", parse("3/minute"))
    codes = [http.get(path).status_code for _ in range(5)]
    assert codes == [codes[0]] * 3 + [429] * 2


def test_the_server_imports_nothing_heavy() -> None:
    assert heavy_imports("assistax_board.app", "assistax_board.work.worker") == []


@pytest.mark.parametrize("path", ["/api/work/lease", "/api/work/x/refused"])
def test_who_asks_comes_before_what_is_asked(http: TestClient, path: str) -> None:
    """Nothing of a body is parsed for somebody without a token."""
    answer = http.post(path, content=b"[" * 1000, headers={"X-Lease": "x"})
    assert (answer.status_code, answer.json()["error"]["code"]) == (401, "not_signed_in")


@pytest.mark.parametrize(
    ("most", "paths"),
    [
        (64 * 1024, ("/api/work/lease", "/api/work/x/refused", f"/pairs/{TASK}/a/b", "/api/none")),
        (4 * 1024 * 1024 + 64 * 1024, ("/api/work/x/result",)),
        (MAX_BODY, ("/api/submissions",)),
        (MOST_BODY, ("/submit",)),
    ],
)
def test_body_limit_depends_on_route(http: TestClient, paths: tuple[str, ...], most: int) -> None:
    for path in paths:
        for size, is_refused in ((most, False), (most + 1, True)):
            answer = http.post(path, content=bytes(8), headers={"Content-Length": str(size)})
            assert (answer.status_code == 413) == is_refused, path


def test_a_wrong_body_is_told_by_its_field(service: Service, http: TestClient) -> None:
    body = {"worker": "", "versions": []}
    answer = http.post("/api/work/lease", json=body, headers=bearer(service, "work"))
    assert answer.status_code == 422
    assert answer.json()["error"]["message"].startswith("body.worker:")


@pytest.mark.parametrize("path", ["/", "/api/health", f"/tasks/{TASK}", "/openapi.json"])
def test_head_is_get_without_a_body(http: TestClient, path: str) -> None:
    head, get = http.head(path), http.get(path)
    assert (head.status_code, head.content) == (200, b"")
    assert head.headers["content-type"] == get.headers["content-type"]
    assert head.headers["content-length"] == get.headers["content-length"]


@pytest.mark.parametrize("path", ["/nope", "/ledger?after=x", "/submissions/x/receipt.json"])
def test_a_browser_gets_a_page_of_an_error(http: TestClient, path: str) -> None:
    browser = {"Accept": "text/html,*/*;q=0.8"}
    page = http.get(path, headers=browser)
    assert 404 <= page.status_code <= 422 and "That did not work" in page.text
    assert page.headers["content-security-policy"]
    for answer in (http.get("/nope"), http.get("/api/nope", headers=browser)):
        assert answer.json()["error"]["code"] == "not_found"


@pytest.mark.parametrize("after", ["1" + 23 * "0", "-5", "7"])
def test_any_number_is_a_place_in_the_ledger(http: TestClient, after: str) -> None:
    assert http.get(f"/ledger?after={after}").status_code == 200
    assert http.get(f"/api/ledger?after={after}").status_code == (200 if after == "7" else 422)


@pytest.mark.parametrize(
    "path",
    [
        *("/api/boards/dance", f"/api/boards/{TASK}?season=never", "/api/submissions?season=never"),
        *("/api/submissions?task=dance", "/api/seasons?task=dance"),
    ],
)
def test_what_is_not_there_is_said(http: TestClient, path: str) -> None:
    assert http.get(path).status_code == 404


def test_a_season_may_be_given_by_its_name(service: Service, http: TestClient) -> None:
    season = open_season(service)
    id = scored(service, new_submitter(service), season=season)
    for name in ("spring", season):
        assert http.get(f"/api/submissions?season={name}").json()[0]["id"] == id
        assert len(http.get(f"/api/boards/{TASK}?season={name}").json()["scores"]) == 2


@pytest.mark.usefixtures("one_window")
def test_rate_limit_sends_retry_after(http: TestClient) -> None:
    answers = [http.post("/api/work/lease") for _ in range(31)]
    assert [answer.status_code for answer in answers] == [401] * 30 + [429]
    assert 1 <= int(answers[-1].headers["retry-after"]) <= 60


def test_docs_and_schema_describe_every_operation(http: TestClient) -> None:
    text, schema = html.unescape(http.get("/docs").text), http.get("/openapi.json").json()
    assert len(schema["paths"]) > 20
    assert all(f" {path}</code>" in text for path in schema["paths"])
    assert not re.search(r"(?:src|href)=\"https?:", text)
    assert schema["components"]["securitySchemes"]["token"]["scheme"] == "bearer"
    assert schema["paths"]["/api/submissions"]["post"]["security"] == [{"token": []}]
    assert "security" not in schema["paths"]["/api/submissions"]["get"]
    lease = schema["paths"]["/api/work/lease"]["post"]["requestBody"]["content"]
    assert "worker" in lease["application/json"]["schema"]["properties"]


@pytest.mark.usefixtures("one_window")
def test_lab_sees_its_limits(service: Service, http: TestClient) -> None:
    open_season(service, budget=3)
    client = client_of(service, http, "submit")
    before = client.limits()
    [season] = before["seasons"]
    assert (season["name"], season["left"], season["spent"]) == ("spring", 3, 0)
    assert before["requests_left"] == before["requests_an_hour"] == 60
    client.submit(b"robot 1.0", season="season1", **FIELDS)
    service.submit(new_submitter(service, "other"), draft(season=season["id"]))
    after = client.limits()
    [season] = after["seasons"]
    assert (season["left"], season["reserved"], after["requests_left"]) == (2, 1, 59)
    assert client.limits() == after, "asking spends nothing"
    assert "other" not in str(after)
    assert http.get("/api/limits").status_code == 401
    assert http.get("/api/limits", headers=bearer(service, "work")).status_code == 403


def test_client_retries_after_server_stop() -> None:
    """uvicorn's own 500 is text: the request names itself, so the next server may take it."""
    text = httpx2.Response(500, text="Internal Server Error")
    ours = httpx2.Response(500, json={"error": {"code": "unexpected", "message": "broke"}})
    answers = [text, httpx2.Response(200, json={"id": "a"}), ours]
    transport = SimpleNamespace(request=lambda *_, **__: answers.pop(0))
    client = Client("", transport=transport)
    assert client.submit(b"robot 1.0") == {"id": "a"}
    with pytest.raises(Problem, match="broke"):
        client.about()
