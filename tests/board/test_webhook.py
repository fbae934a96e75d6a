"""The organiser's webhook: messages are signed, tried again, and sent nowhere else."""

import base64
import hashlib
import hmac
import json
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa

from assistax_board.serve import open_service
from assistax_board.service import Service
from assistax_board.store import schema
from assistax_board.store.notices import clear_notices, list_notices
from assistax_board.work import webhook as posting
from assistax_board.work.webhook import Webhook, check_ledger, signature, watched
from assistax_zoo.shell.main import run
from tests.board.fakes import advance, draft, fail_next_job, new_submitter, scored, work_off
from tests.board.running import soon


class Receiver(ThreadingHTTPServer):
    """Takes posts on loopback; answers what it is told to, then 204."""

    daemon_threads = True

    def __init__(self) -> None:
        self.posts: list[tuple[str, dict[str, str], bytes]] = []
        self.statuses: list[int] = []
        super().__init__(("127.0.0.1", 0), _Handler)

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}/hook"


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        receiver: Any = self.server
        body = self.rfile.read(int(self.headers["Content-Length"]))
        receiver.posts.append((self.path, dict(self.headers), body))
        self.send_response(receiver.statuses.pop(0) if receiver.statuses else 204)
        self.send_header("Location", f"http://127.0.0.1:{receiver.server_port}/elsewhere")
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_GET = do_POST

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    server = Receiver()
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def post(hook: Webhook, service: Service) -> None:
    hook.post_new(list_notices(service.database), service.clock())


def test_a_message_is_signed_as_the_standard_says() -> None:
    """The example of the libraries of Standard Webhooks."""
    made = signature(
        "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw",
        "msg_p5jXN8AQM9LWM0D4loKWxJek",
        1614265330,
        b'{"test": 2432232314}',
    )
    assert made == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_notice_is_posted_with_a_valid_signature(
    tmp_path: Path, service: Service, receiver: Receiver
) -> None:
    id = service.submit(new_submitter(service), draft(2.0))
    fail_next_job(service)
    hook = Webhook(receiver.address, tmp_path)
    post(hook, service)
    [(path, headers, body)] = receiver.posts
    assert path == "/hook" and headers["Content-Type"] == "application/json"
    message = json.loads(body)
    assert message["type"] == "notice.worker_errors" and message["data"]["about"] == id
    file = tmp_path / "webhook-secret"
    assert file.stat().st_mode & 0o077 == 0
    key = base64.b64decode(file.read_text().strip().removeprefix("whsec_"))
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.".encode() + body
    code = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{code}"
    assert abs(int(headers["webhook-timestamp"]) - time.time()) < 60
    post(hook, service)
    post(Webhook(receiver.address, tmp_path), service)
    assert len(receiver.posts) == 1, "each is posted once, also after a restart"
    file.write_text("whsec_short\n")
    with pytest.raises(ValueError, match="webhook-secret holds no secret"):
        Webhook(receiver.address, tmp_path)


def test_refused_post_is_repeated_with_same_id(
    tmp_path: Path, service: Service, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(posting, "POLL_SECONDS", 0.02)
    service.note("season_closed", "spring")
    advance(service, 1.0)
    service.note("too_full", "files")
    receiver.statuses = [500, 503, 429]
    with watched(service, tmp_path, receiver.address):
        assert soon(lambda: len(receiver.posts) == 5, 300.0)
        time.sleep(0.2)
    kinds = [json.loads(body)["data"]["kind"] for _, _, body in receiver.posts]
    assert kinds == ["season_closed"] * 4 + ["too_full"]
    assert len({headers["webhook-id"] for _, headers, _ in receiver.posts[:4]}) == 1


def test_pauses_grow_while_a_receiver_is_away(
    tmp_path: Path, service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []

    class Over(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            pauses.append(timeout or 0.0)
            return len(pauses) > 12

    service.note("too_full", "files")
    hook = Webhook("http://127.0.0.1:9/", tmp_path)  # nobody is there
    posting._watch(Over(), lambda: post(hook, service))  # private: the loop that threads run
    assert pauses[:4] == [10.0, 20.0, 40.0, 80.0] and max(pauses) == 3600.0


def test_repeated_notice_is_posted_once_an_hour(
    tmp_path: Path, service: Service, receiver: Receiver
) -> None:
    hook = Webhook(receiver.address, tmp_path)
    for _ in range(100):
        service.note("unexpected", "KeyError at x.py:3")
        post(hook, service)
        advance(service, 60.0)
    counts = [json.loads(body)["data"]["count"] for _, _, body in receiver.posts]
    assert counts == [1, 61]
    clear_notices(service.database, service.clock())
    post(hook, service)
    service.note("unexpected", "KeyError at x.py:3")
    post(hook, service)
    assert len(receiver.posts) == 3, "what comes after it was read is news"


def test_a_redirect_is_not_followed(tmp_path: Path, service: Service, receiver: Receiver) -> None:
    service.note("too_full", "files")
    receiver.statuses = [307, 302]
    hook = Webhook(receiver.address, tmp_path)
    for status in (307, 302):
        with pytest.raises(OSError, match=f"status {status}"):
            post(hook, service)
    assert [path for path, _, _ in receiver.posts] == ["/hook", "/hook"]


@pytest.mark.parametrize("url", ["file:///etc/passwd", "ftp://x/", "localhost:80", "http://"])
def test_only_the_web_is_posted_to(
    tmp_path: Path, url: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["serve", "--data", str(tmp_path / "board"), "--webhook", url]) == 1
    assert "http:// or https://" in capsys.readouterr().err
    assert not (tmp_path / "board").exists()


def test_a_changed_ledger_is_told(service: Service) -> None:
    scored(service, new_submitter(service), 2.0)
    check_ledger(service)
    assert list_notices(service.database) == []
    with service.database.write() as connection:
        entry = sa.update(schema.ledger).where(schema.ledger.c.seq == 1)
        connection.execute(entry.values(body={"id": "another"}))
    check_ledger(service)
    [notice] = list_notices(service.database)
    assert notice.kind == "ledger" and notice.about.startswith("ledger entry 1 does not follow")


def test_no_request_posts_or_waits(
    tmp_path: Path, service: Service, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A receiver that takes its time keeps nobody but the thread that posts."""
    monkeypatch.setattr(posting, "POLL_SECONDS", 0.02)
    taken, answer = threading.Event(), threading.Event()
    monkeypatch.setattr(_Handler, "do_POST", lambda _: taken.set() or answer.wait(30))
    service.note("too_full", "files")
    with watched(service, tmp_path, receiver.address):
        assert taken.wait(30)
        service.note("too_full", "files")
        service.submit(new_submitter(service), draft(2.0))
        assert work_off(service) == 3
    assert not answer.is_set(), "the end did not wait for it either"
    answer.set()


@pytest.mark.slow
def test_a_served_folder_posts_its_notices(tmp_path: Path, receiver: Receiver) -> None:
    data = tmp_path / "board"
    service = open_service(data)
    service.note("season_closed", "spring")
    options = ["--data", data, "--port", "0", "--workers", "0", "--no-references"]
    process = subprocess.Popen(
        [sys.executable, "-m", "assistax_zoo", "serve", *options, "--webhook", receiver.address],
        stderr=subprocess.DEVNULL,
    )
    try:
        assert soon(lambda: len(receiver.posts) == 1, 300.0)
    finally:
        process.terminate()
        assert process.wait(60) == 0
    kinds = {json.loads(body)["type"] for _, _, body in receiver.posts}
    assert kinds == {"notice.season_closed"}
