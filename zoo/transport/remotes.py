"""Remotes, which hold published bytes: a folder, a web server, a hub, or a place for fsspec.

A remote has the layout of a checkout: `registry.json`, and the shards at the paths that it lists.
"""

import contextlib
import dataclasses
import functools
import re
import threading
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, NoReturn, Protocol, TypeVar

from assistax_base.errors import MissingFileError, OfflineError, RemoteError, ZooError, shorten
from assistax_base.extras import optional
from assistax_base.parallel import run_all

CHUNK = 1 << 20
_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+|\*)")
_TRANSIENT = (408, 425, 429, 500, 502, 503, 504)
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Retry:
    """Number and pauses of further attempts after a request that failed."""

    attempts: int = 5  # without any progress
    pause: float = 0.5  # seconds, doubled each time
    longest: float = 30.0  # seconds; also the most that a server's Retry-After may ask for


RETRY = Retry()


class TransientError(Exception):
    """A failure that may pass; `wait` is the pause that the server asked for, in seconds."""

    def __init__(self, reason: str, wait: float | None = None) -> None:
        super().__init__(reason)
        self.wait = wait


Stream = tuple[int, Iterator[bytes]]  # a file's bytes from that offset on: 0 without ranges


class Remote(Protocol):
    """Protocol of remotes, as fetching uses them."""

    @property
    def name(self) -> str:
        """How the user called it."""

    @property
    def revision(self) -> str | None:
        """The commit that is read, asked for once; None if the remote has no commits."""

    def open(self, path: str, start: int = 0) -> contextlib.AbstractContextManager[Stream]:
        """Open a file's bytes from `start` on.

        Raises:
            RemoteError: The file is not there or cannot be read.
            TransientError: It may be there on the next attempt.
        """


def with_retries(
    work: Callable[[], T],
    what: str,
    *,
    reached: Callable[[], int] = lambda: 0,
    refuse: Callable[[str], ZooError] | None = None,
    stop: threading.Event | None = None,
) -> T:
    """Return the result of `work`, tried again with growing pauses after a `TransientError`.

    Args:
        work: May fail `RETRY.attempts` times in a row.
        what: Names it in errors.
        reached: How far it is; getting further ends the row.
        refuse: Makes the error of the last attempt, given the failure in words.
        stop: Ends a pause.

    Raises:
        RemoteError: It failed for the last time.
    """
    advice = "try again later; complete files are kept"
    refuse = refuse or functools.partial(RemoteError, what, "an answer", next_step=advice)
    attempt = 0
    before = reached()
    while True:
        try:
            return work()
        except TransientError as error:
            attempt, before = 1 if reached() > before else attempt + 1, reached()
            if attempt >= RETRY.attempts:
                raise refuse(f"{error}, {attempt} times") from None
            wait = RETRY.pause * 2 ** (attempt - 1) if error.wait is None else error.wait
            (stop or threading.Event()).wait(min(wait, RETRY.longest))


def read_file(remote: Remote, path: str, limit: int) -> bytes:
    """Return a small file of a remote.

    Raises:
        RemoteError: It is not there, cannot be read, or is larger than `limit`.
    """

    def read() -> bytes:
        data = bytearray()
        with remote.open(path) as (_, chunks):
            for chunk in chunks:
                data += chunk
                if len(data) > limit:
                    advice = "check that this is a zoo"
                    raise RemoteError(what, f"at most {limit} bytes", "more", advice)
        return bytes(data)

    what = f"{path} of {remote.name}"
    [content] = run_all([lambda stop: with_retries(read, what)], 1, limit, what)
    return content


@dataclasses.dataclass(frozen=True)
class FileRemote:
    """A folder, or another place that fsspec can open."""

    name: str
    revision: str | None = None

    @contextlib.contextmanager
    def open(self, path: str, start: int = 0) -> Generator[Stream]:
        """Open a file's bytes, as `Remote.open`."""
        with contextlib.ExitStack() as stack:
            with self._errors(path):
                file = stack.enter_context(self._opened(path))
                file.seek(start)
            yield start, self._chunks(file, path)

    def _opened(self, path: str) -> Any:
        if "://" not in self.name:
            return Path(self.name, path).open("rb")
        fsspec = optional("fsspec", f"a remote such as {shorten(self.name)}", "remotes")
        system, root = fsspec.url_to_fs(self.name)
        return system.open(f"{root.rstrip('/')}/{path}", "rb")

    def _chunks(self, file: Any, path: str) -> Iterator[bytes]:
        while True:
            with self._errors(path):
                chunk = file.read(CHUNK)
            if not chunk:
                return
            yield chunk

    @contextlib.contextmanager
    def _errors(self, path: str) -> Generator[None]:
        try:
            yield
        except (FileNotFoundError, NotADirectoryError):
            raise missing(path, self) from None
        except (ImportError, ValueError) as error:
            raise bad_address(
                self.name, "a folder, https://..., hf://org/name or a URL that fsspec opens", error
            ) from None
        except OSError as error:
            if "://" in self.name:
                raise TransientError(shorten(str(error))) from None
            raise RemoteError(
                f"{path} of {self.name}",
                "a file that can be read",
                str(error.strerror or error),
                "check the folder",
            ) from None


class HttpRemote:
    """A folder behind a web server; ranges are used where the server knows them."""

    def __init__(self, name: str) -> None:
        self.name = name

    @property
    def revision(self) -> str | None:
        """None: a web server has no commits."""
        return None

    def url(self, path: str) -> str:
        """Return the address of a file."""
        return f"{self.name.rstrip('/')}/{path}"

    def headers(self) -> dict[str, str]:
        """Return the headers of every request."""
        return {}

    @contextlib.contextmanager
    def open(self, path: str, start: int = 0) -> Generator[Stream]:
        """Open a file's bytes, as `Remote.open`."""
        from huggingface_hub import constants
        from huggingface_hub.utils import get_session

        headers = {**self.headers(), "Accept-Encoding": "identity"}
        if start:
            headers["Range"] = f"bytes={start}-"
        with network_errors(self):
            url, timeout = self.url(path), constants.HF_HUB_DOWNLOAD_TIMEOUT
            with get_session().stream("GET", url, headers=headers, timeout=timeout) as response:
                yield self._check(response, path, start), response.iter_raw()

    def _check(self, response: Any, path: str, start: int) -> int:
        """Return the offset at which the body starts, or raise for a status that is no success."""
        status = response.status_code
        if status == 200:
            return 0
        if status == 206:
            match = _RANGE.fullmatch(response.headers.get("Content-Range", ""))
            if match is None or int(match[1]) != start:
                raise TransientError(
                    f"another range than asked for ({response.headers.get('Content-Range')})"
                )
            return start
        if status in (404, 410):
            raise missing(path, self)
        refuse_status(response, f"{path} of {self.name}")


def refuse_status(response: Any, what: str) -> NoReturn:
    """Raise for an HTTP status: `TransientError` if it may pass, else `RemoteError`."""
    status = response.status_code
    if status in _TRANSIENT:
        raise TransientError(f"status {status}", _retry_after(response))
    if status in (401, 403):
        raise RemoteError(
            what,
            "a file that you may read",
            f"status {status}",
            "log in, for a hub with `hf auth login`",
        )
    raise RemoteError(what, "status 200", f"status {status}", "check the address")


def missing(path: str, remote: Remote) -> MissingFileError:
    """Return the error for a file that the remote does not hold."""
    registry = path == "registry.json"
    advice = "check the address" if registry else "ask its owner, or fetch from another remote"
    return MissingFileError(remote.name, f"a zoo with {path} in it", "no such file", advice)


@contextlib.contextmanager
def network_errors(remote: Remote) -> Generator[None]:
    """Raise `RemoteError` or `TransientError` in place of the errors of the HTTP client."""
    import httpx2
    from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled

    try:
        yield
    except OfflineModeIsEnabled:
        found = "offline mode (HF_HUB_OFFLINE)"
        raise OfflineError(remote.name, "its files in the cache, or a network", found) from None
    except HfHubHTTPError:
        raise
    except ImportError as error:  # of the HTTP client, for a proxy of another protocol
        raise RemoteError(
            remote.name,
            "a proxy that is reached by HTTP",
            shorten(str(error).partition(". ")[0]),
            "install socksio with: pip install socksio, or unset ALL_PROXY and HTTPS_PROXY",
        ) from None
    except (httpx2.InvalidURL, httpx2.TooManyRedirects, httpx2.UnsupportedProtocol) as error:
        raise RemoteError(
            remote.name, "an address that leads somewhere", shorten(str(error)), "check the address"
        ) from None
    except httpx2.TransportError as error:
        raise TransientError(
            f"{type(error).__name__}: {shorten(str(error) or 'no answer')}"
        ) from None


def _retry_after(response: Any) -> float | None:
    text = response.headers.get("Retry-After", "")
    return float(text) if text.isdecimal() else None


def bad_address(text: str, expected: str, error: Exception | None = None) -> RemoteError:
    """Return the error of an address that names no remote."""
    return RemoteError(f"remote {shorten(text)}", expected, str(error) if error else shorten(text))
