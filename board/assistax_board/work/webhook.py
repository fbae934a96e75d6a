"""Posts notices to the organiser's address, and checks the ledger.

Messages are those of Standard Webhooks (standardwebhooks.com): JSON, signed with HMAC-SHA256 by a
secret that both sides know. A thread beside the server posts them: no request waits for that, and
the organiser alone names the address, which may thus be a private one.
"""

import base64
import contextlib
import functools
import hashlib
import hmac
import json
import logging
import secrets
import threading
import time
from collections.abc import Callable, Generator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import urlsplit

import httpx2

from assistax_base.files import OWNER, atomic_write, write_json
from assistax_board.checking import ledger_pages
from assistax_board.service import Service
from assistax_board.store.ledger import check_chain
from assistax_board.store.notices import Notice, list_notices

SECRET_FILE, SENT_FILE = "webhook-secret", "webhook-sent.json"
PREFIX = "whsec_"  # before the base64 of a secret
POLL_SECONDS = 10.0
LONGEST_PAUSE = 3600.0  # between two tries; each is twice as long after the one before
AGAIN_SECONDS = 3600.0  # between two posts of one notice that goes on happening
MAX_ADDRESS = 500
ANSWER_SECONDS = 10.0  # that each step of a post may take
LEDGER_SECONDS = 86_400.0  # between two checks of the ledger
_LOG = logging.getLogger("assistax_board")


class Webhook:
    """Address, secret and posted entries of a webhook, kept in files over restarts."""

    def __init__(self, url: str, data: Path) -> None:
        """Read the secret of a data folder; a new folder gets one.

        Raises:
            ValueError: The address is not one of http or https, or the file holds no secret.
        """
        check_address(url)
        self._url, self._sent_file = url, data / SENT_FILE
        path = data / SECRET_FILE
        if not path.is_file():
            atomic_write(path, f"{secret_text(secrets.token_bytes(32))}\n".encode(), OWNER)
        self._secret = path.read_text().strip()
        signature(self._secret, "", 0, b"")
        self._sent: dict[str, float] = {}  # when a notice that was posted had happened last
        if self._sent_file.is_file():
            self._sent = json.loads(self._sent_file.read_text())

    def post_new(self, notices: Sequence[Notice], now: float) -> None:
        """Post the notices that were not posted, the oldest first.

        One that goes on happening is posted again once an hour.

        Raises:
            OSError: The address does not take one; it and those after it come next time.
        """
        keys = [f"{notice.kind} {notice.about}" for notice in notices]
        self._sent = {key: at for key, at in self._sent.items() if key in keys}
        for key, notice in list(zip(keys, notices, strict=True))[::-1]:
            sent = self._sent.get(key)
            if sent is None or (notice.last_at > sent and now >= sent + AGAIN_SECONDS):
                self._post(notice)
                self._sent[key] = notice.last_at
                write_json(self._sent_file, self._sent)

    def _post(self, notice: Notice) -> None:
        """Post one; the same one has the same id at every try."""
        words = f"{notice.kind} {notice.about} {notice.first_at} {notice.last_at}"
        post(self._url, self._secret, words, notice_message(notice))


def post(url: str, secret: str, words: str, message: dict[str, object]) -> None:
    """Post a message, signed; the same words make the same id, by which its receiver knows it.

    Raises:
        OSError: The address does not take it.
    """
    at, body = int(time.time()), json.dumps(message).encode()
    id = f"msg_{hashlib.sha256(words.encode()).hexdigest()[:32]}"
    headers = {
        "Content-Type": "application/json",
        "webhook-id": id,
        "webhook-timestamp": str(at),
        "webhook-signature": signature(secret, id, at, body),
    }
    ask = functools.partial(httpx2.stream, "POST", url, content=body, headers=headers)
    try:  # what it answers beside the status is not read
        with ask(timeout=ANSWER_SECONDS, follow_redirects=False) as response:
            status = response.status_code
    except httpx2.TransportError as error:
        raise OSError(type(error).__name__) from error
    if not 200 <= status < 300:
        raise OSError(f"status {status}")


def check_address(url: str | None) -> None:
    """Check a webhook's address; None means that there is no webhook.

    Raises:
        ValueError: It is not an address of http or https, with a host.
    """
    parts = urlsplit(url or "http://none")
    if parts.scheme not in ("http", "https") or not parts.hostname or len(url or "") > MAX_ADDRESS:
        raise ValueError(
            f"the webhook is {url!r}; give an address of http:// or https://, of at most "
            f"{MAX_ADDRESS} letters"
        )


def secret_text(secret: bytes) -> str:
    """Return a secret as Standard Webhooks writes it."""
    return f"{PREFIX}{base64.b64encode(secret).decode()}"


def notice_message(notice: Notice) -> dict[str, object]:
    """Return a notice as Standard Webhooks has messages."""
    at = datetime.fromtimestamp(notice.last_at, UTC).isoformat(timespec="seconds")
    data = {"kind": notice.kind, "about": notice.about, "text": notice.text, "count": notice.count}
    return {"type": f"notice.{notice.kind}", "timestamp": at, "data": data}


def signature(secret: str, id: str, at: int, body: bytes) -> str:
    """Return the header `webhook-signature` of a message.

    Raises:
        ValueError: The secret is not `whsec_` and base64 of 24 to 64 bytes.
    """
    with contextlib.suppress(ValueError):
        key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
        if secret.startswith(PREFIX) and 24 <= len(key) <= 64:
            signed = hmac.digest(key, f"{id}.{at}.".encode() + body, "sha256")
            return f"v1,{base64.b64encode(signed).decode()}"
    raise ValueError(
        f"the file {SECRET_FILE} holds no secret; write {PREFIX} and the base64 of 24 to 64 random "
        "bytes there, or remove it to get a new one"
    )


@contextlib.contextmanager
def watched(service: Service, data: Path, url: str | None) -> Generator[None]:
    """Check the ledger once a day, and post notices to an address if one is given.

    This ends with the block.
    """
    over, checked_at = threading.Event(), -LEDGER_SECONDS
    webhook = None if url is None else Webhook(url, data)

    def step() -> None:
        nonlocal checked_at
        if time.monotonic() - checked_at >= LEDGER_SECONDS:
            checked_at = time.monotonic()
            check_ledger(service)
        if webhook is not None:
            webhook.post_new(list_notices(service.database), service.clock())

    threading.Thread(target=_watch, args=(over, step), daemon=True).start()
    try:
        yield
    finally:
        over.set()  # a thread may be waiting for an answer: nobody waits for it


def _watch(over: threading.Event, step: Callable[[], None]) -> None:
    pause = POLL_SECONDS
    while not over.wait(pause):
        try:
            step()
            pause = POLL_SECONDS
        except Exception as error:  # a receiver or a database that is away comes back
            pause = min(2 * pause, LONGEST_PAUSE)
            fields = {"error": type(error).__name__, "again_in": pause}
            if isinstance(error, OSError):
                fields["error"] = str(error)
            _LOG.warning("not posted", extra={"fields": fields})


def check_ledger(service: Service) -> None:
    """Tell the organiser if the ledger is no unbroken chain any more."""
    try:
        check_chain(ledger_pages(service.queries.ledger))
    except ValueError as error:
        service.note("ledger", str(error))
