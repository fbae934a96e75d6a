"""Checks before every request: size, rate, and identity."""

import asyncio
import ipaddress
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import Depends, Request, Security
from fastapi.exceptions import RequestValidationError
from fastapi.security import HTTPBearer
from limits import parse
from pydantic import BaseModel, ValidationError

from assistax_board.problems import CODES, Problem
from assistax_board.rules.scoring import MAX_TABLE_BYTES
from assistax_board.rules.submissions import MAX_BYTES
from assistax_board.rules.tokens import Principal, authenticate
from assistax_board.service import Service
from assistax_board.vocabulary import Scope

SMALL_BODY = 64 * 1024  # of JSON and of forms without files
MAX_BODY = MAX_BYTES + SMALL_BODY  # a file and the fields of a form
FORM_BYTES = 32 * 1024 * 1024  # all files of a form, whose sender is unknown until it is read
MOST_BODY = FORM_BYTES + SMALL_BODY
# What may be larger: a robot, a form with several, a worker's result.
_LARGE = {"/api/submissions": MAX_BODY, "/submit": MOST_BODY}
BODY_SECONDS = 120.0  # for a whole body to arrive: a client may be slow, but not for ever
FORM_SECONDS = 30.0  # for that of a form, whose sender is known when it has arrived

READ, SUBMIT, SIGN_IN = parse("1200/minute"), parse("60/hour"), parse("30/minute")
PAGES = parse("3000/minute")  # one address may be a whole institute's
MADE = parse("120/minute")  # pages that nobody asked for before: searched, sorted, compared
FILMS = parse("20/hour")  # that are asked for: each takes a core for half a minute
FORM = parse("20/minute")  # forms with files, whose token can be read only with the file


class HeadAsGet:
    """ASGI middleware: HEAD is answered as GET is, without the body."""

    def __init__(self, app: Any) -> None:
        self._app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass a request on."""
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await self._app(scope, receive, send)
            return

        async def without_body(message: Any) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        await self._app({**scope, "method": "GET"}, receive, without_body)


class BodyLimit:
    """ASGI middleware: a body that is too large, or too slow, is not read to its end."""

    def __init__(
        self, app: Any, *, most: int = FORM_BYTES + SMALL_BODY, seconds: float = BODY_SECONDS
    ) -> None:
        self._app, self._most, self._seconds = app, most, seconds

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass a request on, counting the bytes that arrive."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        if "\0" in scope["path"] or b"%00" in scope["query_string"]:
            # No name has such a character, and PostgreSQL fails where one is asked for.
            await _answer(send, Problem("not_found", "there is nothing of this name"))
            return
        headers = dict(scope["headers"])
        if headers.keys() >= {b"content-length", b"transfer-encoding"}:
            # A proxy may take the one for the body's end, and this server the other.
            text = "a request has Content-Length or Transfer-Encoding, not both"
            await _answer(send, Problem("invalid", text), 400)
            return
        most = min(self._most, largest_body(scope["path"]))
        length = headers.get(b"content-length", b"0")
        if not length.isdigit() or int(length) > most:
            await _answer(send, Problem("too_large", f"this request has at most {most} bytes"))
            return
        seconds = min(self._seconds, FORM_SECONDS) if scope["path"] == "/submit" else self._seconds
        await self._app(scope, self._counted(receive, most, seconds), send)

    def _counted(self, receive: Any, most: int, seconds: float) -> Callable[[], Any]:
        loop = asyncio.get_running_loop()
        seen, whole, end = 0, False, loop.time() + seconds

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
            return {"type": "http.disconnect"} if seen > most else message

        return counted


def check_proxy(proxy: str | None) -> None:
    """Refuse a trusted proxy's name that is not an address.

    Raises:
        ValueError: It is none: a wider one would let clients choose their own addresses.
    """
    for part in (proxy or "").split(",") if proxy is not None else ():
        try:
            network = ipaddress.ip_network(part.strip())
        except ValueError:
            network = None
        if network is None or network.prefixlen == 0:
            raise ValueError(
                f"the proxy is {part.strip()!r}; give its address as the server sees it, such as "
                "127.0.0.1, or a network such as 10.0.0.0/24"
            )


def largest_body(path: str) -> int:
    """Return how many bytes the body of a request to this path may have."""
    if path.startswith("/api/work/") and path.endswith("/result"):
        return MAX_TABLE_BYTES + SMALL_BODY
    return _LARGE.get(path, SMALL_BODY)


def json_body(model: type[BaseModel]) -> tuple[Any, dict[str, Any]]:
    """Return a dependency that reads a body of a model, and its entry for OpenAPI.

    FastAPI would read a body before it asks who sends it; a dependency has its turn after those
    that stand before it.
    """

    async def read(request: Request) -> BaseModel:
        try:
            return model.model_validate_json(await request.body())
        except ValidationError as invalid:
            errors = invalid.errors(include_url=False)
            placed = [{**error, "loc": ("body", *error["loc"])} for error in errors]
            raise RequestValidationError(placed) from None

    content = {"application/json": {"schema": model.model_json_schema()}}
    return Depends(read), {"requestBody": {"required": True, "content": content}}


def service_of(request: Request) -> Service:
    """Return the service that an application is of."""
    return request.app.state.service


TheService = Annotated[Service, Depends(service_of)]


def client_of(request: Request) -> str:
    """Return the address that a request came from, of IPv6 its network, which is all one client's.

    An IPv4 address that a socket of IPv6 shows is that address.
    """
    host = request.client.host if request.client else "unknown"
    try:
        address = ipaddress.IPv6Address(host)
    except ValueError:
        return host
    return str(address.ipv4_mapped or ipaddress.IPv6Network((int(address), 64), strict=False))


def count_read(request: Request) -> None:
    """Count a request that needs no token, by its address."""
    request.app.state.limiter.hit(READ, client_of(request))


_BEARER = HTTPBearer(
    auto_error=False, scheme_name="token", description="From the organiser, such as azt_..."
)


def count_page(request: Request) -> None:
    """Count a page, by the address of its reader."""
    request.app.state.limiter.hit(PAGES, client_of(request))


def signed_in(scope: Scope) -> Any:
    """Return a dependency: the owner of the token in the header, if it may do this."""

    def check(request: Request, sent: Annotated[Any, Security(_BEARER)]) -> Principal:
        return sign_in(request, sent.credentials if sent else "", scope)

    return Depends(check)


def sign_in(request: Request, token: str, scope: Scope) -> Principal:
    """Return the owner of a token that came with a request, if it may do this."""
    try:
        if not token:
            raise Problem("not_signed_in", "send a token: Authorization: Bearer TOKEN")
        principal = authenticate(service_of(request).database, token)
    except Problem:
        request.app.state.limiter.hit(SIGN_IN, client_of(request))  # guessing is slow
        raise
    if scope not in principal.scopes:
        raise Problem("not_allowed", f"this token may not {scope}; ask the organiser for one")
    request.state.token = principal.token
    return principal


Submitter = Annotated[Principal, signed_in("submit")]
Worker = Annotated[Principal, signed_in("work")]


async def _answer(send: Any, problem: Problem, status: int | None = None) -> None:
    """Answer with a problem, in another status than its own if one is given, and hang up."""
    import json

    body = json.dumps({"error": {"code": problem.code, "message": problem.message}}).encode()
    headers = [(b"content-type", b"application/json"), (b"connection", b"close")]
    start = {"status": status or CODES[problem.code], "headers": headers}
    await send({"type": "http.response.start", **start})
    await send({"type": "http.response.body", "body": body})
