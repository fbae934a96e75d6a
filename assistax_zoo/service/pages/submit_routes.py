"""The form by which a robot is handed in: a file, a token, and a name. Works without scripts.

The token is typed, or filled in by the browser's own store, with each form. No cookie signs anybody
in, so no other site can act for its owner; the form itself is answered only to who was given it.
"""

from typing import Annotated, Any

from fastapi import APIRouter, File, Form, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import RedirectResponse, Response

from assistax_zoo.service.api.guards import sign_in
from assistax_zoo.service.api.submitting import hand_in
from assistax_zoo.service.ids import new_id
from assistax_zoo.service.pages import security
from assistax_zoo.service.pages.site import Site
from assistax_zoo.service.problems import CODES, Problem
from assistax_zoo.service.submissions import LICENCES, Draft

Field = Annotated[str, Form()]


def submit_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/submit")
    def form(request: Request, task: str = "") -> Response:
        chosen = {"task": task} if task in site.tasks else {}
        return site.form(request, "submit.html", **form_values(site, chosen))

    @router.post("/submit")
    async def submit(
        request: Request,
        request_id: Field = "",
        account_token: Field = "",
        task: Field = "",
        method: Field = "",
        licence: Field = "",
        season: Field = "",
        file: Annotated[bytes, File()] = b"",
        form_token: Annotated[str, Form(alias=security.FIELD)] = "",
    ) -> Response:
        if not site.tokens.accepts(request, form_token):
            return site.fresh("error.html", request.url.path, 403, message=security.NOT_OURS)
        try:
            owner = await run_in_threadpool(sign_in, request, account_token.strip(), "submit")
            if not file:
                raise Problem("invalid", "choose a file that is not empty")
            draft = Draft(task, method.strip(), request_id, licence, season or None, data=file)
            with request.app.state.desk.place(str(owner.submitter)):
                found = await hand_in(request, owner, draft)
        except Problem as problem:
            given = {"task": task, "method": method, "licence": licence, "season": season}
            return await run_in_threadpool(come_back, site, request, given, problem)
        return RedirectResponse(f"/submissions/{found.id}", 303)

    return router


def come_back(site: Site, request: Request, given: dict[str, str], problem: Problem) -> Response:
    """Answer with the form as it was filled in, and why nothing was handed in."""
    values = form_values(site, given, "Nothing was handed in: " + problem.message)
    return site.form(request, "submit.html", CODES[problem.code], **values)


def form_values(site: Site, given: dict[str, str], message: str = "") -> dict[str, Any]:
    """Return what the form shows: the choices, what was given before, and why it came back."""
    seasons = [one for one in site.queries.seasons() if one.state == "open"]
    given = {"task": site.tasks[0], "method": "", "licence": LICENCES[-1], "season": ""} | given
    choices = {"seasons": seasons, "licences": LICENCES}
    return {**choices, "given": given, "message": message, "request_id": new_id(20)}
