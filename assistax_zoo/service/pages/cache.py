"""Rendered pages, kept for a moment: two hundred readers of one board cost one rendering a second.

A page may so be a second old. Nobody waits for a rendering that another thread has begun if there
is an older copy to show.
"""

import collections
import dataclasses
import gzip
import hashlib
import threading
import time
from collections.abc import Callable

from starlette.requests import Request
from starlette.responses import Response

_PAGES = 512  # kept; addresses are made by readers, so there is no end of them
_IMMUTABLE = "public, max-age=31536000, immutable"


@dataclasses.dataclass(frozen=True)
class Page:
    """A rendered body, packed once for all its readers."""

    body: bytes
    packed: bytes  # gzip
    etag: str
    media_type: str


def pack(body: bytes, media_type: str = "text/html; charset=utf-8") -> Page:
    """Return a body with its packed form and its name by content."""
    packed = gzip.compress(body, compresslevel=6, mtime=0)
    return Page(body, packed, f'"{hashlib.sha256(body).hexdigest()[:32]}"', media_type)


class PageCache:
    """Pages by key, the least recently read dropped first."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._entries: collections.OrderedDict[str, _Entry] = collections.OrderedDict()

    def page(self, key: str, seconds: float, render: Callable[[], str]) -> Page:
        """Return the page of a key, rendered anew if it is older than `seconds`."""
        entry = self._entry(key)
        if entry.page and (self._clock() < entry.until or entry.lock.locked()):
            return entry.page
        with entry.lock:
            if entry.page is None or self._clock() >= entry.until:
                entry.page = pack(render().encode())
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
