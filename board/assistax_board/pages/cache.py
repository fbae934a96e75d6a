"""Rendered pages, kept for a moment: two hundred readers of one board cost one rendering a second.

A page may so be a second old. Nobody waits for a rendering if there is a copy to show that is not
much older.
"""

import collections
import contextlib
import dataclasses
import gzip
import hashlib
import threading
import time
from collections.abc import Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

WAITING = 5.0  # seconds that a page may be too old and is still shown while a new one is made
_PAGES = 512  # kept; addresses are made by readers, so there is no end of them
HTML = "text/html; charset=utf-8"
_IMMUTABLE = "public, max-age=31536000, immutable"


@dataclasses.dataclass(frozen=True)
class Page:
    """A rendered body, packed once for all its readers."""

    body: bytes
    packed: bytes  # gzip
    etag: str
    media_type: str


def pack(body: bytes, media_type: str = HTML) -> Page:
    """Return a body with its packed form and its name by content."""
    packed = gzip.compress(body, compresslevel=6, mtime=0)
    return Page(body, packed, f'"{hashlib.sha256(body).hexdigest()[:32]}"', media_type)


class PageCache:
    """Pages by key, the least recently read dropped first."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._entries: collections.OrderedDict[str, _Entry] = collections.OrderedDict()

    def page(
        self, key: str, seconds: float, render: Callable[[], str], media_type: str = HTML
    ) -> Page:
        """Return the page of a key, at most `seconds` old, or a little older while it is made."""

        def made() -> Page:
            return pack(render().encode(), media_type)

        entry = self._entry(key)
        age = self._clock() - entry.until
        if entry.page and (age < 0 or entry.lock.locked()):
            return entry.page
        if entry.page and age < WAITING:  # a board takes long when a score was added
            behind = threading.Thread(target=self._try_to_renew, args=(entry, seconds, made))
            behind.daemon = True
            behind.start()
            return entry.page
        return self._renew(entry, seconds, made)

    def _try_to_renew(self, *args: Any) -> None:
        with contextlib.suppress(Exception):  # who finds no copy to be shown will see the error
            self._renew(*args)

    def _renew(self, entry: "_Entry", seconds: float, made: Callable[[], Page]) -> Page:
        with entry.lock:
            if entry.page is None or self._clock() >= entry.until:
                entry.page = made()
                entry.until = self._clock() + seconds
            return entry.page

    def _entry(self, key: str) -> "_Entry":
        with self._lock:
            entry = self._entries.setdefault(key, _Entry())
            self._entries.move_to_end(key)
            if len(self._entries) > _PAGES:
                self._entries.popitem(last=False)
            return entry


class _Entry:
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.page: Page | None = None
        self.until = 0.0


def respond(request: Request, page: Page, *, immutable: bool = False) -> Response:
    """Answer with a page: empty if the reader has it already, packed if the reader can unpack."""
    headers = {
        "ETag": page.etag,
        "Cache-Control": _IMMUTABLE if immutable else "no-cache",
        "Vary": "Accept-Encoding",
    }
    if page.etag in request.headers.get("if-none-match", ""):
        return Response(status_code=304, headers=headers)
    body = page.body
    if "gzip" in request.headers.get("accept-encoding", ""):
        body, headers["Content-Encoding"] = page.packed, "gzip"
    return Response(body, media_type=page.media_type, headers=headers)
