"""A worker: takes a job, plays it, brings the table, and takes the next.

It may run anywhere and die at any time: it keeps nothing that the server lacks. Its log says which
job it does, never with whom.
"""

import contextlib
import dataclasses
import logging
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Generator
from typing import Any

from assistax_base.digest import sha256
from assistax_board.client import Client, fields_of
from assistax_board.problems import Problem, Refusal
from assistax_board.robots.limited import resident_bytes
from assistax_board.rules.jobs import LEASE_SECONDS
from assistax_board.rules.scoring import Scorer, Work, encode_table

log = logging.getLogger("assistax_board")
IDLE_SECONDS = 2.0  # between two looks at an empty queue

LOOK_SECONDS = 0.25  # between two looks at what a job takes


@dataclasses.dataclass(frozen=True)
class Budget:
    """Limits of a job, several times the cost of the most expensive admitted robot."""

    seconds: float = 1800.0  # of processors, so that a busy machine refuses nobody
    clock_seconds: float = 7200.0  # where an accelerator works instead
    memory: int = 4 * 1024**3  # bytes more than before the job


class Worker:
    """One worker of one server."""

    def __init__(
        self,
        client: Client,
        scorer: Scorer,
        *,
        idle: float = IDLE_SECONDS,
        beat: float = LEASE_SECONDS / 4,
        budget: Budget = Budget(),
        restart: Callable[[], Any] = lambda: os._exit(1),
    ) -> None:
        """Prepare to work.

        Args:
            client: Of the server, with a token that may work.
            scorer: Plays.
            idle: Seconds between two looks at an empty queue.
            beat: Seconds between two beats for a job.
            budget: Of each job; what takes more is refused as `too_slow`.
            restart: Ends this process, or starts it anew, after such a job: it cannot be stopped.
        """
        self._client, self._scorer = client, scorer
        self._idle, self._beat = idle, beat
        self._budget, self._restart = budget, restart
        self._name = f"{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(2)}"
        self._stopping = threading.Event()
        self._held: Work | None = None
        self._releases: dict[str, bytes] = {}

    def stop(self) -> None:
        """Stop after this job."""
        self._stopping.set()

    def leave(self) -> None:
        """Give back the current job at once, since the process ends."""
        self.stop()
        if self._held is not None:
            self._tell(self._client.give_back, self._held)

    def run(self, *, until_empty: bool = False) -> int:
        """Work until told to stop, or until the queue is empty; return how many jobs were done."""
        done = 0
        while not self._stopping.is_set():
            try:
                work = self._client.lease(self._name, self._scorer.versions())
            except OSError:
                log.warning("server does not answer", extra={"fields": {"worker": self._name}})
                continue
            if work is not None:
                self._held = work
                done += self._do(work)
                self._held = None
            elif until_empty:
                break
            else:
                self._stopping.wait(self._idle)
        return done

    def _do(self, work: Work) -> int:
        """Do one job and report its end to the server; return whether it counted."""
        began = time.monotonic()
        fields = {**fields_of(work), "worker": self._name}
        log.info("job begins", extra={"fields": fields})
        ended = "done"
        try:
            with self._beating(work), self._watching(work):
                table = self._scorer.play(work, self._robot(work), self._release(work))
            with self._beating(work):
                counted = self._bring(work, encode_table(table), time.monotonic() - began)
            ended = "done" if counted else "was done already"
        except Refusal as refusal:
            ended = f"refused: {refusal.code}"
            self._tell(self._client.refused, work, refusal.code)
        except KeyboardInterrupt:
            self._tell(self._client.give_back, work)
            raise
        except Exception as error:
            # The message may hold a hidden value; the class is enough for a first look.
            ended = f"failed: {type(error).__name__}"
            self._tell(self._client.failed, work)
            if os.environ.get("ASSISTAX_ZOO_DEBUG"):
                raise
        log.info("job ends", extra={"fields": {**fields, "ended": ended}})
        return ended == "done"

    def _bring(self, work: Work, data: bytes, seconds: float) -> bool:
        """Bring a result; while the server has no room for it, keep it and ask again.

        A full disk is no fault of the job: five such answers would fail its submission.
        """
        while True:
            try:
                return self._client.result(work, data, seconds)
            except Problem as problem:
                if problem.code != "too_full" or self._stopping.wait(self._idle):
                    raise

    def _tell(self, function: Callable[..., None], *args: Any) -> None:
        with contextlib.suppress(Problem, OSError):  # then the lease runs out
            function(*args)

    @contextlib.contextmanager
    def _beating(self, work: Work) -> Generator[None]:
        def beat() -> bool:
            with contextlib.suppress(Problem, OSError):
                self._client.beat(work)
            return True

        with _poll_while_running(beat, self._beat):
            yield

    @contextlib.contextmanager
    def _watching(self, work: Work) -> Generator[None]:
        """Refuse a job that takes more than its budget, and begin anew without it."""
        used, began, memory = time.process_time(), time.monotonic(), resident_bytes(os.getpid())

        def watch() -> bool:
            seconds, clock = time.process_time() - used, time.monotonic() - began
            grown = resident_bytes(os.getpid()) - memory
            limits = self._budget
            within = seconds <= limits.seconds and clock <= limits.clock_seconds
            if within and grown <= limits.memory:
                return True
            log.warning("job is too slow", extra={"fields": fields_of(work)})
            self._tell(self._client.refused, work, "too_slow")
            self._restart()
            return False

        with _poll_while_running(watch, LOOK_SECONDS):
            yield

    def _robot(self, work: Work) -> Any:
        return self._fetch(work.artefact) if work.artefact else None

    def _release(self, work: Work) -> bytes | None:
        """Return the private release that a job is about; it is kept in memory alone."""
        if work.release is None:
            return None
        if work.release not in self._releases:
            self._releases = {work.release: self._fetch(work.release)}
        return self._releases[work.release]

    def _fetch(self, name: str) -> bytes:
        data = self._client.artefact(name)
        if sha256(data) != name:
            raise ValueError("an artefact arrived damaged")
        return data


@contextlib.contextmanager
def _poll_while_running(check: Callable[[], bool], seconds: float) -> Generator[None]:
    """Call `check` every `seconds` until the block ends or `check` returns False."""
    over = threading.Event()

    def go_on() -> None:
        while not over.wait(seconds) and check():
            pass

    thread = threading.Thread(target=go_on, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
