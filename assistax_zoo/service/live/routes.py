"""The two ends of a room: the client's WebSocket, and the worker's questions over HTTP."""

import asyncio
import contextlib
import time
from typing import Any

import numpy as np
from fastapi import APIRouter, Depends, Request, Response, WebSocket
from starlette.concurrency import run_in_threadpool
from starlette.websockets import WebSocketDisconnect

from assistax_zoo.service.api.errors import RESPONSES
from assistax_zoo.service.api.guards import SIGN_IN, Worker
from assistax_zoo.service.api.submitting import whole_body
from assistax_zoo.service.api.working import LeaseSecret
from assistax_zoo.service.live.messages import decode, encode, unpack_rows
from assistax_zoo.service.live.rooms import Away, BankEmpty, Room, Rooms
from assistax_zoo.service.problems import Problem
from assistax_zoo.service.tokens import authenticate
from assistax_zoo.service.vocabulary import FINAL_STATES

router = APIRouter(prefix="/api", tags=["live"], responses=RESPONSES)
asking = APIRouter(prefix="/api/work", tags=["live"], responses=RESPONSES)
WAIT_SECONDS = 20.0  # of one question of a worker, which then asks again
LOOK_SECONDS = 1.0  # between two looks at whether the submission has ended
POLICY_VIOLATION = 1008  # a WebSocket's closing code


@asking.post("/{job}/ask", response_class=Response)
async def ask(
    request: Request,
    worker: Worker,
    job: str,
    lease: LeaseSecret,
    body: bytes = Depends(whole_body),
) -> Response:
    """Put a batch of observations to the live robot; 202 if it has not answered yet: ask again."""
    service, rooms = request.app.state.service, request.app.state.rooms
    submission = await run_in_threadpool(service.live_submission, job, lease)
    try:
        message = decode(body, "observe")
    except ValueError as error:
        raise Problem("invalid", str(error)) from None
    step = message["batch"], message["step"]
    try:
        answer = await rooms.ask(submission, step, body, WAIT_SECONDS)
    except Away:
        await run_in_threadpool(service.live_away, job, lease)
        raise Problem("lease_lost", "the client is away; the job goes back") from None
    except BankEmpty:
        await run_in_threadpool(service.live_failed, submission, "time_bank")
        raise Problem("lease_lost", "the robot has no time left") from None
    if answer is None:
        return Response(status_code=202)
    return Response(answer, media_type="application/msgpack")


@router.websocket("/live/{submission}")
async def live(socket: WebSocket, submission: str) -> None:
    """Connect a live robot: the server sends `observe`, the client answers `act`, until `end`."""
    service, rooms = socket.app.state.service, socket.app.state.rooms
    try:
        await run_in_threadpool(_check_owner, socket, submission)
    except Problem as problem:
        await socket.close(POLICY_VIOLATION, problem.message[:120])
        return
    await socket.accept()
    room = rooms.room(submission)
    room.clients += 1
    try:
        await _converse(socket, service, room, submission)
    except (WebSocketDisconnect, RuntimeError):
        pass  # it may come again
    finally:
        room.clients -= 1
        room.seen_at = time.monotonic()


async def _converse(socket: WebSocket, service: Any, room: Room, submission: str) -> None:
    sent, next_look = None, 0.0
    while True:
        if room.step is not None and room.answer is None and sent != room.step:
            sent, question = room.step, room.question or b""
            await socket.send_bytes(question)
            await _hear(socket, service, room, submission, question)
        else:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(room.changed.wait(), LOOK_SECONDS)
        if time.monotonic() < next_look:
            continue
        next_look = time.monotonic() + LOOK_SECONDS
        found = await run_in_threadpool(service.queries.submission, submission)
        if found is None or found.state in FINAL_STATES:
            await socket.send_bytes(encode("end", state=found.state if found else "failed"))
            socket.app.state.rooms.close(submission)
            return


async def _hear(
    socket: WebSocket, service: Any, room: Room, submission: str, question: bytes
) -> None:
    """Take the answer to the step that waits; a wrong one ends the submission."""
    data = await socket.receive_bytes()
    try:
        message = decode(data, "act")
        rows = unpack_rows(message)
        asked = decode(question, "observe")
        if message["rows"] != asked["rows"]:
            raise ValueError("other rows than were asked")
        broken = not np.isfinite(rows).all()
    except ValueError:
        broken, code = True, "malformed"
    else:
        code = "not_finite"
    if broken:
        await run_in_threadpool(service.live_refused, submission, code)
    elif (message["batch"], message["step"]) == room.step:  # no new worker has begun anew
        room.answer = data
        room.wake()


def _check_owner(socket: WebSocket, submission: str) -> None:
    state = socket.app.state
    kind, _, token = socket.headers.get("authorization", "").partition(" ")
    try:
        principal = authenticate(state.service.database, token if kind.lower() == "bearer" else "")
    except Problem:
        state.limiter.hit(SIGN_IN, socket.client.host if socket.client else "unknown")
        raise
    if not state.service.owns_live(submission, principal.submitter):
        raise Problem("not_found", "you have no live submission of this id")


def add_live(app: Any) -> None:
    """Add rooms and routes to the application."""
    app.state.rooms = Rooms()
    app.include_router(asking)
    app.include_router(router)
