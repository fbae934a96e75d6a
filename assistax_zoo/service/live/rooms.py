"""Where a worker and a live client meet: one room a submission, in the server's memory.

Everything here runs in the server's event loop, so nothing needs a lock. A server that restarts
forgets the rooms; worker and client both come again, and the step is sent again.
"""

import asyncio
import dataclasses
import time

TIME_BANK = 900.0  # seconds that a robot may think in all
RESUME_SECONDS = 60.0  # for a lost connection to come back within a batch
GONE_SECONDS = 600.0  # for a client to come at all


class Away(Exception):
    """The client is not connected, and has not been for `RESUME_SECONDS`."""


class BankEmpty(Exception):
    """The robot has used up its time for thinking."""


@dataclasses.dataclass
class Room:
    """One live submission: the step that waits for an answer, and the last answer."""

    seen_at: float  # when the client was last connected
    changed: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)
    step: tuple[str, int] | None = None  # batch and number
    question: bytes | None = None
    answer: bytes | None = None
    clients: int = 0
    thought: float = 0.0
    closed: bool = False

    def wake(self) -> None:
        """Let everybody who waits look again."""
        self.changed.set()
        self.changed = asyncio.Event()


class Rooms:
    """All rooms of this server."""

    def __init__(self, *, resume: float = RESUME_SECONDS, bank: float = TIME_BANK) -> None:
        self._rooms: dict[str, Room] = {}
        self._resume, self._bank = resume, bank
        self._began = time.monotonic()

    def room(self, submission: str) -> Room:
        """Return the room of a submission."""
        return self._rooms.setdefault(submission, Room(seen_at=self._began))

    def connected(self) -> tuple[str, ...]:
        """Return the submissions whose clients are there: only their jobs are given out."""
        return tuple(name for name, room in list(self._rooms.items()) if room.clients)

    def away_for(self, submission: str) -> float:
        """Return for how many seconds nobody has been in a room."""
        room = self.room(submission)
        return 0.0 if room.clients else time.monotonic() - room.seen_at

    def close(self, submission: str) -> None:
        """Forget a room whose submission has ended."""
        if room := self._rooms.pop(submission, None):
            room.closed = True
            room.wake()

    async def ask(
        self, submission: str, step: tuple[str, int], question: bytes, wait: float
    ) -> bytes | None:
        """Put a step to the client; return its answer, or None if it takes longer than `wait`.

        The same step may be put again, also after it was answered.

        Raises:
            Away: The client has not come back for too long.
            BankEmpty: Its time is used up.
        """
        room, end = self.room(submission), time.monotonic() + wait
        if room.step != step:
            room.step, room.question, room.answer = step, question, None
            room.wake()
        while room.answer is None:
            began = time.monotonic()
            if began >= end or room.closed:
                return None
            await self._change(room, min(end - began, 1.0))
            if room.clients:
                room.thought += time.monotonic() - began
            elif self.away_for(submission) > self._resume:
                raise Away
            if room.thought > self._bank:
                raise BankEmpty
        return room.answer

    async def _change(self, room: Room, seconds: float) -> None:
        try:
            await asyncio.wait_for(room.changed.wait(), seconds)
        except TimeoutError:
            return
