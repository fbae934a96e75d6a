"""Where a worker and a live client meet: one room a submission, in the server's memory.

Everything here runs in the server's event loop, so nothing needs a lock. A server that restarts
forgets the rooms; worker and client both come again, and the step is sent again.
"""

import asyncio
import dataclasses
import time

from assistax_board.problems import Problem

TIME_BANK = 900.0  # seconds that steps may wait for a robot in all, also while it is away
RESUME_SECONDS = 60.0  # for a lost connection to come back within a batch
GONE_SECONDS = 600.0  # for a client to come at all
LIFE_SECONDS = 86_400.0  # for a live submission to end, however its client comes and goes
SEATS_OF_OWNER = 16  # connections of one lab at once
SEATS = 400  # of all labs: requests need room beside them


class Away(Exception):
    """The client is not connected, and has not been for `RESUME_SECONDS`."""


class BankEmpty(Exception):
    """The robot has used up its time for thinking."""


@dataclasses.dataclass(eq=False)
class Seat:
    """One connection of a client to its room."""

    submission: str
    owner: str
    owed: int = 0  # questions that were sent and not answered
    replaced: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)


@dataclasses.dataclass
class Room:
    """One live submission: the step that waits for an answer, and the last answer."""

    seen_at: float  # when the client was last connected
    seat: Seat | None = None  # the newest connection of its client
    changed: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)
    step: tuple[str, int] | None = None  # batch and number
    question: bytes | None = None
    answer: bytes | None = None
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
        self._seats: set[Seat] = set()
        self._resume, self._bank = resume, bank

    def room(self, submission: str) -> Room:
        """Return the room of a submission."""
        return self._rooms.setdefault(submission, Room(seen_at=time.monotonic()))

    def take_seat(self, submission: str, owner: str) -> Seat:
        """Connect a client to its room; an older connection of the submission is replaced.

        Raises:
            Problem: The lab, or all labs together, have too many connections.
        """
        others = [seat for seat in self._seats if seat.submission != submission]
        own = sum(seat.owner == owner for seat in others)
        if own >= SEATS_OF_OWNER or len(others) >= SEATS:
            message = f"at most {SEATS_OF_OWNER} live robots of a lab play at once; try again later"
            raise Problem("too_many_requests", message)
        room, seat = self.room(submission), Seat(submission, owner)
        if room.seat is not None:
            room.seat.replaced.set()
        room.seat = seat
        self._seats.add(seat)
        return seat

    def leave(self, seat: Seat) -> None:
        """Note that a connection is over."""
        self._seats.discard(seat)
        room = self._rooms.get(seat.submission)
        if room is not None and room.seat is seat:
            room.seat, room.seen_at = None, time.monotonic()

    def connected(self) -> tuple[str, ...]:
        """Return the submissions whose clients are there: only their jobs are given out."""
        return tuple(name for name, room in list(self._rooms.items()) if room.seat)

    def away_for(self, submission: str) -> float:
        """Return for how many seconds nobody has been in a room."""
        room = self.room(submission)
        return 0.0 if room.seat else time.monotonic() - room.seen_at

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
            # Also while it is away: short connections would cost no time otherwise.
            room.thought += time.monotonic() - began
            if self.away_for(submission) > self._resume:
                raise Away
            if room.thought > self._bank:
                raise BankEmpty
        return room.answer

    async def _change(self, room: Room, seconds: float) -> None:
        try:
            await asyncio.wait_for(room.changed.wait(), seconds)
        except TimeoutError:
            return
