"""Rendered pages, kept for a moment: two hundred readers of one board cost one rendering a second.

A page may so be a second old. Nobody waits for a rendering if there is a copy to show that is not
much older. Readers make addresses, so there is no end of them: searched and sorted pages are made a
few at a time, and the cache is bounded in bytes.
"""

import collections
import contextlib
import dataclasses
import gzip
import hashlib
import threading
import time
from collections.abc import Callable, Generator
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from assistax_board.problems import Problem

WAITING = 5.0  # seconds that a page may be too old and is still shown while a new one is made
PATIENCE = 1.0  # seconds that a reader of a limited page waits for those before it
AT_ONCE = 2  # limited pages that are made
MOST_BYTES = 64 * 1024 * 1024  # of all pages that are kept
_OVERHEAD = 2048  # bytes of an entry beside its page
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

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, most_bytes: int = MOST_BYTES
    ) -> None:
        self._clock, self._most_bytes, self._bytes = clock, most_bytes, 0
        self._making = threading.BoundedSemaphore(AT_ONCE)
        self._lock = threading.Lock()
        self._entries: collections.OrderedDict[str, _Entry] = collections.OrderedDict()

    def lacks(self, key: str) -> bool:
        """Return whether a page was never made, or was dropped."""
        with self._lock:
            entry = self._entries.get(key)
            return entry is None or entry.page is None

    def page(
        self,
        key: str,
        seconds: float,
        render: Callable[[], str],
        media_type: str = HTML,
        *,
        limited: bool = False,
    ) -> Page:
        """Return the page of a key, at most `seconds` old, or a little older while it is made.

        Args:
            key: Names the page.
            seconds: Age from which it is made anew.
            render: Makes its text.
            media_type: Its media type.
            limited: Whether few such pages are made at once, as anybody can ask for any number.

        Raises:
            Problem: Too many of the limited pages are being made.
        """

        def made() -> Page:
            with self._turn() if limited else contextlib.nullcontext():
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
                page = made()
                entry.page, entry.until = page, self._clock() + seconds
                with self._lock:
                    self._weigh(entry, len(page.body) + len(page.packed))
            return entry.page

    @contextlib.contextmanager
    def _turn(self) -> Generator[None]:
        if not self._making.acquire(timeout=PATIENCE):
            raise Problem("unavailable", "many pages are being made; try again soon", 5)
        try:
            yield
        finally:
            self._making.release()

    def _entry(self, key: str) -> "_Entry":
        with self._lock:
            if key not in self._entries:
                self._entries[key] = _Entry()
                self._weigh(self._entries[key], len(key))
            self._entries.move_to_end(key)
            return self._entries[key]

    def _weigh(self, entry: "_Entry", size: int) -> None:
        """Note how large an entry is, and drop those that were read least recently."""
        if not entry.is_kept:  # dropped while it was made
            return
        self._bytes += size + _OVERHEAD - entry.size
        entry.size = size + _OVERHEAD
        while self._bytes > self._most_bytes and len(self._entries) > 1:
            _, gone = self._entries.popitem(last=False)
            gone.is_kept = False
            self._bytes -= gone.size


class _Entry:
    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.is_kept = True  # until it is dropped, though a reader may still wait for it
        self.size = 0  # bytes in memory, about
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
