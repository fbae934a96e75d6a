"""The organiser's page: notices and failures, and a form that acts.

The token comes with each form, as on the page that hands robots in: no cookie signs anybody in.
"""

import time
from datetime import datetime
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from assistax_board.api.guards import sign_in
from assistax_board.checking import ledger_pages
from assistax_board.clock import seconds_of
from assistax_board.pages import security
from assistax_board.pages.routes.submitting import read_form
from assistax_board.pages.site import Site
from assistax_board.problems import CODES, Problem
from assistax_board.service import Service
from assistax_board.store.ledger import check_chain
from assistax_board.store.notices import clear_notices, list_notices

ACTIONS = {
    "look": "only look",
    "ledger": "check the ledger's chain",
    "retry": "queue a failed submission again",
    "extend": "let a season close later",
    "disqualify": "take a lab out of a season",
    "clear": "forget the notices: I have read them",
}
FIELDS = (
    security.FIELD,
    "account_token",
    "action",
    "submission",
    "season",
    "lab",
    "closes",
    "seen",
    "extra_attempt",
)


def organiser_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/organise")
    def form(request: Request) -> Response:
        return site.form(request, "organise.html", actions=ACTIONS, message="", overview=None)

    @router.post("/organise")
    async def organise(request: Request) -> Response:
        if not site.tokens.may_send(request):
            return site.fresh("error.html", request.url.path, 403, message=security.NOT_OURS)
        try:
            fields, _ = await read_form(request, FIELDS)
        except Problem as problem:
            message, status = problem.message, CODES[problem.code]
            return site.fresh("error.html", request.url.path, status, message=message)
        if not site.tokens.accepts(request, fields[security.FIELD]):
            return site.fresh("error.html", request.url.path, 403, message=security.NOT_OURS)
        return await run_in_threadpool(answer, site, request, fields)

    return router


def answer(site: Site, request: Request, fields: dict[str, str]) -> Response:
    """Run an organiser's action, and show the page with its result."""
    service: Service = request.app.state.service
    try:
        sign_in(request, fields["account_token"].strip(), "organise")
    except Problem as problem:
        values = {"actions": ACTIONS, "message": problem.message, "overview": None}
        return site.form(request, "organise.html", CODES[problem.code], **values)
    try:
        message, status = act(service, fields), 200
    except Problem as problem:
        message, status = f"Nothing was done: {problem.message}", CODES[problem.code]
    except ValueError as error:
        message, status = f"Nothing was done: {error}", 422
    values = {"message": message, "overview": overview(service)}
    return site.form(request, "organise.html", status, actions=ACTIONS, **values)


def act(service: Service, fields: dict[str, str]) -> str:
    """Run one of `ACTIONS` and return a sentence about it.

    Raises:
        Problem: It cannot be done.
        ValueError: A date is none, or the ledger is no chain.
    """
    submission, season, lab = (fields[name].strip() for name in ("submission", "season", "lab"))
    match fields["action"]:
        case "ledger":
            last = check_chain(ledger_pages(service.queries.ledger))
            return f"The ledger's {last} entries are an unbroken chain."
        case "retry":
            service.retry(submission, extra_attempt=bool(fields["extra_attempt"]))
            return f"Submission {submission} is queued again."
        case "extend":
            service.extend_season(season, seconds_of(datetime.fromisoformat(fields["closes"])))
            return f"Season {season} closes later."
        case "disqualify":
            return f"{service.disqualify(season, lab)} submissions of {lab} left season {season}."
        case "clear":
            seen = fields["seen"]
            clear_notices(service.database, float(seen) if seen else 0.0)
            return "The notices that were shown are forgotten."
    return ""


def overview(service: Service) -> dict[str, Any]:
    """Return the values of the organiser's page."""
    return {
        "notices": list_notices(service.database),
        "failures": service.failures(),
        "seasons": service.queries.seasons(drafts=True),
        "now": time.time(),
    }
