"""Where a worker and a live client meet: one room a submission, in the memory of a server.

Everything here runs in the server's event loop, so nothing needs a lock. Which server has the
connection, and what was asked at another one, is in the database: see `seats`. A server that
restarts forgets the rooms; worker and client both come again, and the step is sent again.
"""

import asyncio
import contextlib
import dataclasses
import time
from collections.abc import AsyncGenerator

from sqlalchemy.exc import SQLAlchemyError
from starlette.concurrency import run_in_threadpool

from assistax_board.live.messages import Step, is_newer
from assistax_board.live.seats import Asked, Seats
from assistax_board.problems import Problem
from assistax_board.rules.tokens import Principal
from assistax_board.vocabulary import FINAL_STATES

TIME_BANK = 900.0  # seconds that steps may wait for a robot in all, also while it is away
RESUME_SECONDS = 60.0  # for a lost connection to come back within a batch
SEATS = 400  # connections of all labs here: requests need room beside them
POLL_SECONDS = 0.05  # between two looks at what was asked, or answered, at another server
LOOK_SECONDS = 1.0  # between two looks at which connections have ended
WAITING = 64  # at the door; who is sent away comes again
DOORS = 2  # at which connections come and go: a crowd there leaves the processor to requests
BOOK_SECONDS = 1.0  # of thinking that are written down together


class Away(Exception):
    """The client is not connected, and has not been for `RESUME_SECONDS`."""


class BankEmpty(Exception):
    """The robot has used up its time for thinking."""


@dataclasses.dataclass(eq=False)
class Seat:
    """One connection of a client to its room."""

    submission: str
    name: str
    token: str  # id of the client's
    action_size: int
    owed: int = 0  # questions that were sent and not answered
    over: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)
    state: str | None = None  # in which its submission ended; None if another took the place

    def end(self, state: str | None) -> None:
        """Let the connection be closed."""
        self.state = state
        self.over.set()


@dataclasses.dataclass
class Room:
    """One live submission: the step that waits for an answer, and the last answer."""

    seat: Seat | None = None  # the newest connection of its client, if it is here
    changed: asyncio.Event = dataclasses.field(default_factory=asyncio.Event)
    step: Step | None = None
    question: bytes | None = None
    answer: bytes | None = None
    thought: float = 0.0  # seconds that are not written down yet
    elsewhere: Step | None = None  # the last step that was asked at another server

    def put(self, step: Step, question: bytes) -> None:
        """Let a step wait for its answer, unless it is there or a later one was put."""
        if is_newer(step, self.step):
            self.step, self.question, self.answer = step, question, None
            self.wake()

    def answer_to(self, step: Step) -> bytes | None:
        """Return the answer to a step."""
        return self.answer if self.step == step else None

    def wake(self) -> None:
        """Let everybody who waits look again."""
        self.changed.set()
        self.changed = asyncio.Event()


class Rooms:
    """All rooms of this server."""

    def __init__(
        self, seats: Seats, *, resume: float = RESUME_SECONDS, bank: float = TIME_BANK
    ) -> None:
        self.seats = seats
        self._rooms: dict[str, Room] = {}
        self._here: dict[str, Seat] = {}
        self._keeping: asyncio.Task[None] | None = None
        self._doors, self._coming = asyncio.Semaphore(DOORS), 0
        self._resume, self._bank = resume, bank

    def room(self, submission: str) -> Room:
        """Return the room of a submission."""
        return self._rooms.setdefault(submission, Room())

    @contextlib.asynccontextmanager
    async def door(self) -> AsyncGenerator[None]:
        """Let a client in, one after another.

        Raises:
            Problem: Too many are waiting.
        """
        self._check_door()
        self._coming += 1
        try:
            async with self._doors:
                yield
        finally:
            self._coming -= 1

    def knock(self) -> None:
        """Say before a connection is made whether its client would be sent away at the door.

        Many knock in one turn of the event loop; each counts until its own turn has come.

        Raises:
            Problem: Too many are waiting.
        """
        self._check_door()
        self._coming += 1
        asyncio.get_running_loop().call_soon(self._let_go)

    def _check_door(self) -> None:
        if self._coming >= WAITING:
            raise Problem("too_many_requests", "too many live robots come at once; try again later")

    def _let_go(self) -> None:
        self._coming -= 1

    async def take_seat(self, submission: str, owner: Principal, action_size: int) -> Seat:
        """Connect a client to its room; an older connection of the submission is replaced.

        The caller has come through the door; `owner` is a lab, by its token.

        Raises:
            Problem: The lab, or all labs together, have too many connections.
        """
        if sum(seat.submission != submission for seat in self._here.values()) >= SEATS:
            message = f"at most {SEATS} live robots play here at once; try again later"
            raise Problem("too_many_requests", message)
        name = await run_in_threadpool(self.seats.take, submission, str(owner.submitter))
        room, seat = self.room(submission), Seat(submission, name, owner.token, action_size)
        if room.seat is not None:
            room.seat.end(None)
        room.seat = self._here[name] = seat
        if self._keeping is None or self._keeping.done():
            self._keeping = asyncio.create_task(self._keep())
        return seat

    async def leave(self, seat: Seat) -> None:
        """Note that a connection is over."""
        del self._here[seat.name]
        room, thought = self._rooms.get(seat.submission), 0.0
        if room is not None and room.seat is seat:
            del self._rooms[seat.submission]
            thought, room.thought = room.thought, 0.0
            room.wake()
        async with self._doors:
            await run_in_threadpool(self.seats.leave, seat.submission, seat.name, thought)

    async def hear(self, submission: str, answer: bytes) -> None:
        """Take a client's answer to the step that waits."""
        room = self.room(submission)
        room.answer = answer
        room.wake()
        if room.elsewhere is not None and room.elsewhere == room.step:
            await run_in_threadpool(self.seats.answered, submission, room.step, answer)

    async def ask(self, asked: Asked, wait: float) -> bytes | None:
        """Put a step to the client; return its answer, or None if it takes longer than `wait`.

        The same step may be put again, also after it was answered, and at any server.

        Raises:
            Away: The client has not come back for too long.
            BankEmpty: Its time is used up.
        """
        end, is_put = time.monotonic() + wait, False
        while True:
            began, room = time.monotonic(), self._rooms.get(asked.submission)
            left, away = max(0.0, min(end - began, LOOK_SECONDS)), 0.0
            if room is not None:
                answer = await self._ask_here(room, asked, left)
            else:
                if not is_put and not await run_in_threadpool(self.seats.put, asked):
                    return None
                is_put = True
                answer, away = await run_in_threadpool(
                    self.seats.answer, asked.submission, asked.step
                )
                if answer is None:
                    await asyncio.sleep(min(left, POLL_SECONDS))
            await self._think(asked.submission, room, time.monotonic() - began)
            if away > self._resume:
                raise Away
            if answer is not None or time.monotonic() >= end:
                return answer

    async def _ask_here(self, room: Room, asked: Asked, seconds: float) -> bytes | None:
        room.put(asked.step, asked.question)
        if room.answer_to(asked.step) is None:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(room.changed.wait(), seconds)
        return room.answer_to(asked.step)

    async def _think(self, submission: str, room: Room | None, seconds: float) -> None:
        """Count time, also while the client is away: short connections would cost none otherwise.

        Raises:
            BankEmpty: There is none left.
        """
        if room is not None and self._rooms.get(submission) is room:
            room.thought += seconds
            if room.thought < BOOK_SECONDS:
                return
            seconds, room.thought = room.thought, 0.0
        if await run_in_threadpool(self.seats.think, submission, seconds) > self._bank:
            raise BankEmpty

    async def _keep(self) -> None:
        """Keep the places of all connections here, and take in what was asked elsewhere."""
        looked = -LOOK_SECONDS
        while self._here:
            with contextlib.suppress(SQLAlchemyError):  # it is away; places last for a while
                if time.monotonic() - looked >= LOOK_SECONDS:
                    looked = time.monotonic()
                    await self._look({name: seat.token for name, seat in self._here.items()})
                await self._take_in()
            await asyncio.sleep(POLL_SECONDS)

    async def _look(self, tokens: dict[str, str]) -> None:
        """End the connections that lost place or token, or whose submissions have ended."""
        states = await run_in_threadpool(self.seats.keep, tokens)
        for name in tokens:
            seat, state = self._here.get(name), states.get(name)
            if seat is not None and (state is None or state in FINAL_STATES):
                seat.end(state)

    async def _take_in(self) -> None:
        for row in await run_in_threadpool(self.seats.pending):
            room, step = self._rooms.get(row.submission), (row.batch, row.step)
            if room is None or row.seat not in self._here:
                continue
            room.elsewhere = step
            room.put(step, row.question)
            if answer := room.answer_to(step):
                await run_in_threadpool(self.seats.answered, row.submission, step, answer)
