"""One form for every error: {"error": {"code", "message"}}, without traceback or values."""

import logging
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from sqlalchemy.exc import InterfaceError, OperationalError
from starlette.exceptions import HTTPException

from assistax_zoo.service.problems import CODES, Problem

log = logging.getLogger("assistax_zoo.service")
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


def add_error_handlers(app: FastAPI) -> None:
    """Answer every error in the one form."""

    @app.exception_handler(Problem)
    def problem(_: Request, error: Problem) -> JSONResponse:
        return _answer(CODES[error.code], error.code, error.message)

    @app.exception_handler(RequestValidationError)
    def invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        return _answer(422, "invalid", f"{place}: {first['msg']}")

    @app.exception_handler(HTTPException)
    def other(_: Request, error: HTTPException) -> JSONResponse:
        code = _STATUS_CODES.get(error.status_code, "invalid")
        return _answer(error.status_code, code, str(error.detail), dict(error.headers or {}))

    @app.exception_handler(OperationalError)
    @app.exception_handler(InterfaceError)
    def no_database(_: Request, error: Exception) -> JSONResponse:
        # It is away, full or busy. Who asks again does no harm: every request names itself.
        log.error("no database", extra={"fields": {"error": type(error).__name__}})
        return _answer(503, "unavailable", "the database does not answer; try again soon")

    @app.exception_handler(Exception)
    def unexpected(request: Request, error: Exception) -> JSONResponse:
        # Its text may hold anything, hidden values too: the class and the place are enough.
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        line = f"{place.tb_frame.f_code.co_filename}:{place.tb_lineno}" if place else "?"
        log.error("unexpected", extra={"fields": {"error": type(error).__name__, "at": line}})
        return _answer(500, "unexpected", "something broke; the organiser finds it in the log")


def _answer(
    status: int, code: str, message: str, headers: dict[str, str] | None = None
) -> JSONResponse:
    content = {"error": {"code": code, "message": message}}
    return JSONResponse(content, status, headers=headers)
