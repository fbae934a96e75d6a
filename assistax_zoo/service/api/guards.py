"""What stands before every request: size, rate, and who asks."""

import asyncio
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Depends, Request
from limits import RateLimitItem, parse
from limits.storage import MemoryStorage
from limits.strategies import MovingWindowRateLimiter

from assistax_zoo.service.problems import CODES, Problem
from assistax_zoo.service.submissions import MAX_BYTES
from assistax_zoo.service.tokens import Principal, authenticate
from assistax_zoo.service.vocabulary import Scope

MAX_BODY = MAX_BYTES + 64 * 1024  # a file and the fields of a form
BODY_SECONDS = 120.0  # for a whole body to arrive: a client may be slow, but not for ever

READ, SUBMIT, SIGN_IN = parse("1200/minute"), parse("60/hour"), parse("30/minute")
UPGRADE = parse("120/minute")  # live connections: a client that lost one tries once a second


class Limiter:
    """Counts requests in moving windows, in this process's memory."""

    def __init__(self) -> None:
        self._windows = MovingWindowRateLimiter(MemoryStorage())

    def hit(self, rate: RateLimitItem, who: str) -> None:
        """Count a request.

        Raises:
            Problem: It is one too many.
        """
        if not self._windows.hit(rate, str(rate), who):
            raise Problem("too_many_requests", f"more than {rate}; wait and try again")


class BodyLimit:
    """ASGI middleware: a body that is too large, or too slow, is not read to its end."""

    def __init__(self, app: Any, *, most: int = MAX_BODY, seconds: float = BODY_SECONDS) -> None:
        self._app, self._most, self._seconds = app, most, seconds

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass a request on, counting what arrives of it."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        told = dict(scope["headers"]).get(b"content-length", b"0")
        if not told.isdigit() or int(told) > self._most:
            await _answer(send, Problem("too_large", f"a request has at most {self._most} bytes"))
            return
        await self._app(scope, self._counted(receive), send)

    def _counted(self, receive: Any) -> Callable[[], Any]:
        loop = asyncio.get_running_loop()
        seen, whole, end = 0, False, loop.time() + self._seconds

        async def counted() -> Any:
            nonlocal seen, whole
            if whole:  # what comes now is the connection's end: wait for that as long as it takes
                return await receive()
            try:
                message = await asyncio.wait_for(receive(), max(0.0, end - loop.time()))
            except TimeoutError:
                return {"type": "http.disconnect"}
            seen += len(message.get("body", b""))
            whole = not message.get("more_body", False)
            return {"type": "http.disconnect"} if seen > self._most else message

        return counted


def client_of(request: Request) -> str:
    """Return the address that a request came from."""
    return request.client.host if request.client else "unknown"


def count_read(request: Request) -> None:
    """Count a request that needs no token, by its address."""
    request.app.state.limiter.hit(READ, client_of(request))


def signed_in(scope: Scope) -> Any:
    """Return a dependency: the owner of the token in the header, if it may do this."""

    def check(request: Request) -> Principal:
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        return sign_in(request, token if kind.lower() == "bearer" else "", scope)

    return Depends(check)


def sign_in(request: Request, token: str, scope: Scope) -> Principal:
    """Return the owner of a token that came with a request, if it may do this."""
    try:
        if not token:
            raise Problem("not_signed_in", "send a token: Authorization: Bearer TOKEN")
        principal = authenticate(request.app.state.service.database, token)
    except Problem:
        request.app.state.limiter.hit(SIGN_IN, client_of(request))  # guessing is slow
        raise
    if scope not in principal.scopes:
        raise Problem("not_allowed", f"this token may not {scope}; ask the organiser for one")
    request.state.token = principal.token
    return principal


Submitter = Annotated[Principal, signed_in("submit")]
Worker = Annotated[Principal, signed_in("work")]
Organiser = Annotated[Principal, signed_in("organise")]


async def _answer(send: Any, problem: Problem) -> None:
    import json

    body = json.dumps({"error": {"code": problem.code, "message": problem.message}}).encode()
    headers = [(b"content-type", b"application/json"), (b"connection", b"close")]
    status = CODES[problem.code]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
