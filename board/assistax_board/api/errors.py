"""One form for every error: {"error": {"code", "message"}}, without traceback or values."""

import contextlib
import logging
from typing import Any, TypeVar

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel
from sqlalchemy.exc import InterfaceError, OperationalError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from assistax_board.api.guards import count_read
from assistax_board.problems import CODES, Problem

log = logging.getLogger("assistax_board")
Value = TypeVar("Value")
_STATUS_CODES = {404: "not_found", 405: "invalid", 413: "too_large"}


class ErrorText(BaseModel):
    """A code for programs and a message for people."""

    code: str
    message: str


class ErrorAnswer(BaseModel):
    """The body of every answer that is not a success."""

    error: ErrorText


# For OpenAPI: what any operation may answer besides its own.
RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {"model": ErrorAnswer} for status in sorted({*CODES.values(), 400, 500})
}


def existing(value: Value | None, what: str) -> Value:
    """Return a value that is there.

    Raises:
        Problem: It is not.
    """
    if value is None:
        raise Problem("not_found", f"no such {what}")
    return value


def add_error_handlers(app: FastAPI) -> None:
    """Answer every error in the one form; a browser on a page gets a page of it."""

    @app.exception_handler(Problem)
    def problem(request: Request, error: Problem) -> Response:
        if error.code == "too_full":
            _note(request, "too_full", "files")
        after = error.retry_after
        headers = None if after is None else {"Retry-After": str(after)}
        return _answer(request, CODES[error.code], error.code, error.message, headers)

    @app.exception_handler(RequestValidationError)
    def invalid(request: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        return _answer(request, 422, "invalid", f"{place}: {first['msg']}")

    @app.exception_handler(HTTPException)
    def other(request: Request, error: HTTPException) -> Response:
        try:
            count_read(request)  # no route did
        except Problem as too_many:
            return problem(request, too_many)
        code = _STATUS_CODES.get(error.status_code, "invalid")
        headers = dict(error.headers or {})
        return _answer(request, error.status_code, code, str(error.detail), headers)

    @app.exception_handler(ClientDisconnect)
    def cut_off(request: Request, error: ClientDisconnect) -> Response:
        # No error of the service: without this each would tell the organiser and fill the log.
        message = "the body did not arrive whole, or not in time; send it again"
        return _answer(request, 408, "invalid", message, {"Connection": "close"})

    @app.exception_handler(OperationalError)
    @app.exception_handler(InterfaceError)
    def no_database(request: Request, error: Exception) -> Response:
        # It is away, full or busy. Who asks again does no harm: every request names itself.
        log.error("no database", extra={"fields": {"error": type(error).__name__}})
        message = "the database does not answer; try again soon"
        return _answer(request, 503, "unavailable", message, {"Retry-After": "5"})

    @app.exception_handler(Exception)
    def unexpected(request: Request, error: Exception) -> Response:
        # Its text may hold anything, hidden values too: the class and the place are enough.
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        line = f"{place.tb_frame.f_code.co_filename}:{place.tb_lineno}" if place else "?"
        log.error("unexpected", extra={"fields": {"error": type(error).__name__, "at": line}})
        _note(request, "unexpected", f"{type(error).__name__} at {line}")
        message = "something broke; the organiser has been told"
        return _answer(request, 500, "unexpected", message)


def _note(request: Request, kind: str, about: str) -> None:
    """Tell the organiser, if that can be done now."""
    with contextlib.suppress(Exception):
        request.app.state.service.note(kind, about)


def _answer(
    request: Request, status: int, code: str, message: str, headers: dict[str, str] | None = None
) -> Response:
    page = getattr(request.app.state, "error_page", None)
    reads_pages = "text/html" in request.headers.get("accept", "")
    if page is not None and reads_pages and not request.url.path.startswith("/api/"):
        answer: Response = page(request, status, message)
        answer.headers.update(headers or {})
        return answer
    return JSONResponse({"error": {"code": code, "message": message}}, status, headers=headers)
