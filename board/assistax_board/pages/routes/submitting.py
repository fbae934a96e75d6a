"""The form by which a robot is handed in: a file, a token, and a name. Works without scripts.

The token is typed, or filled in by the browser's own store, with each form. No cookie signs anybody
in, so no other site can act for its owner; the form itself is answered only to who was given it.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import RedirectResponse, Response

from assistax_board.api.guards import FORM, SUBMIT, client_of, sign_in
from assistax_board.api.submitting import hand_in, limits_of
from assistax_board.ids import new_id
from assistax_board.pages import security
from assistax_board.pages.site import Site
from assistax_board.problems import CODES, Problem
from assistax_board.rules.submissions import DESCRIPTION, LICENCES, Draft
from assistax_board.store.shown import Limits

FIELDS = (
    security.FIELD,
    *("request_id", "account_token", "task", "method", "licence", "season", "limits"),
    *DESCRIPTION,
)


def submit_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/submit")
    def form(request: Request, task: str = "") -> Response:
        chosen = {"task": task} if task in site.tasks else {}
        return site.form(request, "submit.html", **form_values(site, chosen))

    @router.post("/submit")
    async def submit(request: Request) -> Response:
        state = request.app.state
        if not site.tokens.may_send(request):
            return site.fresh("error.html", request.url.path, 403, message=security.NOT_OURS)
        try:
            state.limiter.hit(FORM, client_of(request))
            with state.desk.form(client_of(request)):
                texts, file = await read_form(request)
        except Problem as problem:
            message = problem.message
            return site.fresh("error.html", request.url.path, CODES[problem.code], message=message)
        if not site.tokens.accepts(request, texts[security.FIELD]):
            return site.fresh("error.html", request.url.path, 403, message=security.NOT_OURS)
        try:
            token = texts["account_token"].strip()
            owner = await run_in_threadpool(sign_in, request, token, "submit")
            if texts["limits"]:
                return await run_in_threadpool(
                    come_back, site, request, texts, limits=limits_of(request, owner)
                )
            if not file:
                raise Problem("invalid", "choose a file that is not empty")
            names = ("task", "method", "request_id", "licence", "season")
            task, method, request_id, licence, season = (texts[name] for name in names)
            draft = Draft(
                task, method.strip(), request_id, licence, season or None, None, data=file
            )
            words = {name: texts[name].strip().replace("\r", "") for name in DESCRIPTION}
            draft = dataclasses.replace(draft, **words)
            with state.desk.place(str(owner.submitter)):
                submission = await hand_in(request, owner, draft)
        except Problem as problem:
            return await run_in_threadpool(come_back, site, request, texts, problem)
        return RedirectResponse(f"/submissions/{submission.id}", 303)

    return router


async def read_form(
    request: Request, names: Sequence[str] = FIELDS
) -> tuple[dict[str, str], bytes]:
    """Return a form's texts, empty where it lacks one, and its file.

    Raises:
        Problem: It is no form of this page.
    """
    try:
        async with request.form(max_files=1, max_fields=len(names)) as form:
            texts = {name: form.get(name, "") for name in names}
            file = form.get("file")
            data = b"" if file is None or isinstance(file, str) else await file.read()
    except (HTTPException, ClientDisconnect):
        raise Problem("invalid", "this is no form of this page, or it came too slowly") from None
    words = {
        name: text.replace("\0", "") if isinstance(text, str) else ""
        for name, text in texts.items()
    }
    return words, data


def come_back(
    site: Site,
    request: Request,
    texts: dict[str, str],
    problem: Problem | None = None,
    limits: Limits | None = None,
) -> Response:
    """Answer with the form as it was filled in, and why nothing was handed in, or its limits."""
    texts = {name: texts[name] for name in ("task", "method", "licence", "season", *DESCRIPTION)}
    message = "Nothing was handed in: " + problem.message if problem else ""
    values = form_values(site, texts, message, limits)
    return site.form(request, "submit.html", CODES[problem.code] if problem else 200, **values)


def form_values(
    site: Site, texts: dict[str, str], message: str = "", limits: Limits | None = None
) -> dict[str, Any]:
    """Return the values of the form: choices, earlier inputs, and the error if it came back."""
    seasons = [season for season in site.queries.seasons() if season.state == "open"]
    empty = {"task": site.tasks[0], "method": "", "licence": LICENCES[-1], "season": ""}
    texts = empty | dict.fromkeys(DESCRIPTION, "") | texts
    choices = {
        "seasons": seasons,
        "licences": LICENCES,
        "limits": limits,
        "rate": SUBMIT.amount,
        "most": DESCRIPTION,
    }
    return {**choices, "given": texts, "message": message, "request_id": new_id(20)}
