"""The two ends of a room: the client's WebSocket, and the worker's questions over HTTP."""

import asyncio
from collections.abc import Coroutine
from typing import Any

import numpy as np
from fastapi import APIRouter, Depends, Request, Response, WebSocket
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocketDisconnect

from assistax_board.api.errors import RESPONSES
from assistax_board.api.guards import SIGN_IN, TheService, Worker, bearer_token, client_of, denial
from assistax_board.api.submitting import whole_body
from assistax_board.api.working import LeaseSecret
from assistax_board.live.messages import decode, encode, unpack_rows
from assistax_board.live.rooms import Away, BankEmpty, Room, Seat
from assistax_board.live.seats import Asked
from assistax_board.problems import Problem
from assistax_board.rules.tokens import Principal, authenticate

router = APIRouter(prefix="/api", tags=["live"], responses=RESPONSES)
asking = APIRouter(prefix="/api/work", tags=["live"], responses=RESPONSES)
WAIT_SECONDS = 20.0  # of one question of a worker, which then asks again
TAKE_SECONDS = 60.0  # for a client to take a question
POLICY_VIOLATION = 1008  # a WebSocket's closing code


@asking.post("/{job}/ask", response_class=Response)
async def ask(
    request: Request,
    service: TheService,
    worker: Worker,
    job: str,
    lease: LeaseSecret,
    body: bytes = Depends(whole_body),
) -> Response:
    """Put a batch of observations to the live robot; 202 if it has not answered yet: ask again."""
    rooms = request.app.state.rooms
    submission = await run_in_threadpool(service.live_submission, job, lease)
    try:
        message = decode(body, "observe")
    except ValueError as error:
        raise Problem("invalid", str(error)) from None
    step = message["batch"], message["step"]
    try:
        answer = await rooms.ask(Asked(submission, job, lease, step, body), WAIT_SECONDS)
    except Away:
        await run_in_threadpool(service.live_away, job, lease)
        raise Problem("lease_lost", "the client is away; the job goes back") from None
    except BankEmpty:
        await run_in_threadpool(service.fail, submission, "time_bank")
        raise Problem("lease_lost", "the robot has no time left") from None
    if answer is None:
        return Response(status_code=202)
    return Response(answer, media_type="application/msgpack")


@router.websocket("/live/{submission}")
async def live(socket: WebSocket, submission: str) -> None:
    """Connect a live robot: the server sends `observe`, the client answers `act`, until `end`."""
    rooms = socket.app.state.rooms
    try:
        async with rooms.door():
            owner, action_size = await run_in_threadpool(_check_owner, socket, submission)
            seat = await rooms.take_seat(submission, owner, action_size)
    except Problem as problem:
        await socket.send_denial_response(denial(problem))
        return
    try:
        await socket.accept()
        await _first_to_end(
            _talk(socket, rooms.room(submission), seat),
            _listen(socket, rooms.room(submission), seat),
            _end(socket, seat),
        )
    except (WebSocketDisconnect, RuntimeError, TimeoutError):
        pass  # it may come again
    finally:
        await rooms.leave(seat)


async def _first_to_end(*parts: Coroutine[Any, Any, Any]) -> None:
    """Run all at once until one of them ends, and raise its error."""
    tasks = [asyncio.ensure_future(part) for part in parts]
    try:
        ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in ended:
        task.result()


async def _talk(socket: WebSocket, room: Room, seat: Seat) -> None:
    """Send each step that waits for an answer, once to each connection."""
    sent = None
    while True:
        changed = room.changed
        if room.step is not None and room.answer is None and sent != room.step:
            sent = room.step
            seat.owed += 1
            await asyncio.wait_for(socket.send_bytes(room.question or b""), TAKE_SECONDS)
        else:
            await changed.wait()


async def _listen(socket: WebSocket, room: Room, seat: Seat) -> None:
    """Take answers as they come, until the client is gone or says what nobody asked."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            return
        if not seat.owed:
            await socket.close(POLICY_VIOLATION, "an answer to no question")
            return
        seat.owed -= 1
        await _hear(socket, room, seat, message.get("bytes"))


async def _end(socket: WebSocket, seat: Seat) -> None:
    """Tell the client when its submission has ended, or hang up if it came by another way."""
    await seat.over.wait()
    if seat.state is not None:
        await socket.send_bytes(encode("end", state=seat.state))


async def _hear(socket: WebSocket, room: Room, seat: Seat, data: bytes | None) -> None:
    """Take the answer to the step that waits; a wrong one ends the submission."""
    code = None
    try:
        message = decode(data, "act")
        is_asked = (message["batch"], message["step"]) == room.step
        rows = unpack_rows(message)
        if is_asked and message["rows"] != decode(room.question, "observe")["rows"]:
            raise ValueError("other rows than were asked")
        if rows.shape[1] != seat.action_size:
            code = "wrong_sizes"
        elif not np.isfinite(rows).all():
            code = "not_finite"
    except ValueError:
        code = "malformed"
    if code is not None:
        await run_in_threadpool(socket.app.state.service.live_refused, seat.submission, code)
    elif is_asked:  # otherwise a new worker has begun anew
        await socket.app.state.rooms.hear(seat.submission, data)


def _check_owner(socket: WebSocket, submission: str) -> tuple[Principal, int]:
    """Return a live submission's lab and its width of actions, if the token is of that lab."""
    state = socket.app.state
    try:
        principal = authenticate(state.service.database, bearer_token(socket))
    except Problem:
        state.limiter.hit(SIGN_IN, client_of(socket))
        raise
    owner = principal.submitter
    known = "\0" not in submission and state.service.live_action_size(submission, owner)
    if owner is None or not known:
        raise Problem("not_found", "you have no live submission of this id")
    return principal, known
