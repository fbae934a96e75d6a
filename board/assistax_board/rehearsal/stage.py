"""Where a season is rehearsed, and how long anything may take."""

import dataclasses
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from assistax_board.client import Client
from assistax_board.vocabulary import BACKEND, FINAL_STATES

SEASON = "rehearsal"
LIMIT_SECONDS = 1800.0  # for any one thing to happen
SILENT_SECONDS = 30.0  # between two lines about one thing


@dataclasses.dataclass(frozen=True)
class Stage:
    """Where a season is rehearsed."""

    folder: Path  # empty
    task: str
    registry: Path | None  # of the public partners; tiny ones are trained if None
    backend: str = BACKEND
    open_seconds: float = 60.0  # for which labs may hand in, after the last of what is tried

    @property
    def older(self) -> str:
        """Return the engine of the version before: another one makes another version of scores."""
        return "fused" if self.backend != "fused" else "native"

    @property
    def data(self) -> Path:
        """Return the folder of the service."""
        return self.folder / "board"

    @property
    def private(self) -> Path:
        """Return the folder of the private release."""
        return self.folder / "private"

    @property
    def public(self) -> Path:
        """Return the registry of the public partners."""
        return self.registry or self.folder / "public" / "registry.json"


def watch(client: Client, id: str) -> Iterator[str]:
    """Wait for a submission's end; yield a line when a job of it is done, and now and then.

    Raises:
        ValueError: It does not end in half an hour.
    """
    end, said, said_at = time.monotonic() + LIMIT_SECONDS, "", 0.0
    while (row := client.submission(id))["state"] not in FINAL_STATES:
        now = time.monotonic()
        line = f"{id} is {row['state']}: {row['jobs_done']} of {row['jobs']} jobs done"
        if line != said or now > said_at + SILENT_SECONDS:
            yield line
            said, said_at = line, now
        _pause(f"{id} ends", end)


def wait(what: str, is_so: Callable[[], Any]) -> Iterator[str]:
    """Wait until something is so; yield a line now and then.

    Raises:
        ValueError: It is not so for half an hour.
    """
    end, said_at = time.monotonic() + LIMIT_SECONDS, time.monotonic()
    while not is_so():
        if time.monotonic() > said_at + SILENT_SECONDS:
            yield f"waiting: {what}"
            said_at = time.monotonic()
        _pause(what, end)


def _pause(what: str, end: float) -> None:
    if time.monotonic() > end:
        raise ValueError(f"waited {LIMIT_SECONDS / 60:.0f} minutes in vain: {what}")
    time.sleep(0.5)
