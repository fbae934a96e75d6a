"""One file from a remote into the cache: resumed, hashed, renamed; seen whole or not at all."""

import dataclasses
import hashlib
import os
import threading
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from typing import NoReturn

from assistax_base.errors import IntegrityError, RemoteError
from assistax_base.files import exclusive
from zoo.locations import write_errors
from zoo.transport.remotes import Remote, TransientError, with_retries


class Stopped(Exception):
    """Another file failed, or the user interrupted; received bytes are kept for the next time."""


@dataclasses.dataclass(frozen=True)
class Item:
    """A file to fetch, with the number and the digest of its bytes in the registry."""

    path: str  # at the remote
    target: Path
    bytes: int
    sha256: str


def download(
    remote: Remote,
    item: Item,
    advance: Callable[[int], None] = lambda count: None,
    stop: threading.Event | None = None,
) -> int:
    """Fetch a file unless it is there, and return how many bytes came over the wire.

    An interrupted download goes on where it was. Of two that want the same file, one waits for the
    other.

    Args:
        remote: Where the file is.
        item: The file; its bytes are held against `item.sha256` before it gets its name.
        advance: Called with numbers of further bytes, those of an earlier download included.
        stop: Set by others to make it stop.

    Raises:
        RemoteError: The remote does not have the file, or fails again and again.
        IntegrityError: The remote's bytes are not those of the registry.
        CacheError: The cache cannot take them.
    """
    partial = item.target.with_name(f".{item.target.name}.partial")
    with write_errors(partial, item.bytes), exclusive(item.target):
        if item.target.is_file():  # fetched by another process meanwhile
            advance(item.bytes)
            return 0
        try:
            with open(partial, "a+b", buffering=0) as file:
                transfer = _Transfer(remote, item, file, advance, stop or threading.Event())
                transfer.run()
                os.fsync(file.fileno())
        except (IntegrityError, OSError):  # the bytes are wrong, or there is no room
            partial.unlink(missing_ok=True)
            raise
        os.replace(partial, item.target)
        return transfer.received


class _Transfer:
    """State of one download: the file, its size so far, and the bytes over the wire."""

    def __init__(
        self,
        remote: Remote,
        item: Item,
        file: FileIO,
        advance: Callable[[int], None],
        stop: threading.Event,
    ) -> None:
        self.remote, self.item, self.file = remote, item, file
        self.advance, self.stop = advance, stop
        self.received = self.reported = self.size = 0

    def run(self) -> None:
        """Complete the file; a wrong hash after a resumption starts once more anew."""
        self._grow(self.file.seek(0, os.SEEK_END))
        if self.size > self.item.bytes:
            self._restart()
        resumed = self.size > 0
        digest = self._complete()
        if digest != self.item.sha256 and resumed:
            self._restart()
            digest = self._complete()
        if digest != self.item.sha256:
            self._refuse(f"sha256 {self.item.sha256}", f"sha256 {digest}")

    def _complete(self) -> str:
        """Fetch the missing bytes, and return the sha256 of the whole file."""
        what = f"{self.item.path} of {self.remote.name}"
        expected = f"{self.item.bytes} bytes"

        def refuse(found: str) -> RemoteError:
            kept = f"nothing was added; {self.size} bytes are kept to go on from"
            return RemoteError(what, expected, found, "fetch again later", kept)

        with_retries(self._receive, what, reached=lambda: self.size, refuse=refuse, stop=self.stop)
        self.file.seek(0)
        return hashlib.file_digest(self.file, "sha256").hexdigest()

    def _receive(self) -> None:
        if self.size == self.item.bytes:
            return
        with self.remote.open(self.item.path, self.size) as (start, chunks):
            if start != self.size:
                self._restart()
            for chunk in chunks:
                if self.stop.is_set():
                    raise Stopped
                if self.size + len(chunk) > self.item.bytes:
                    self._refuse(f"{self.item.bytes} bytes", "more")
                self._write(chunk)
                self._grow(len(chunk))
                self.received += len(chunk)
        if self.size < self.item.bytes:
            raise TransientError(f"the end after {self.size} bytes")

    def _write(self, chunk: bytes) -> None:
        left = memoryview(chunk)
        while left:
            left = left[self.file.write(left) :]

    def _restart(self) -> None:
        self.file.seek(0)
        self.file.truncate()
        self.size = 0

    def _grow(self, count: int) -> None:
        self.size += count
        if self.size > self.reported:  # after a restart, bytes are not counted twice
            self.advance(self.size - self.reported)
            self.reported = self.size

    def _refuse(self, expected: str, found: str) -> NoReturn:
        raise IntegrityError(
            f"{self.item.path} of {self.remote.name}",
            expected,
            found,
            "fetch from another remote, and tell the owner of this one",
            "nothing was added; the bytes were thrown away",
        )
