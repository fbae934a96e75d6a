"""The form by which robots are handed in: files, a token, and a name. Works without scripts.

One file is a single robot; several are a declared entry, with its card.

The token is typed, or filled in by the browser's own store, with each form. No cookie signs anybody
in, so no other site can act for its owner; the form itself is answered only to who was given it.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import RedirectResponse, Response

from assistax_base.digest import sha256
from assistax_board.api.guards import FORM, FORM_BYTES, SUBMIT, client_of, sign_in
from assistax_board.api.public import season_id
from assistax_board.api.submitting import hand_in, limits_of
from assistax_board.cards import Card
from assistax_board.ids import new_id
from assistax_board.pages import security
from assistax_board.pages.site import Site
from assistax_board.problems import CODES, Problem
from assistax_board.rules.entries import LEAST, MOST, Declaration
from assistax_board.rules.submissions import DESCRIPTION, LICENCES, Draft
from assistax_board.rules.tokens import Principal
from assistax_board.store.shown import Limits, Submission
from assistax_board.vocabulary import GONE_STATES

CARD = tuple(field.name for field in dataclasses.fields(Card))
FIELDS = (
    security.FIELD,
    *("request_id", "account_token", "task", "method", "licence", "season", "limits"),
    *DESCRIPTION,
    *CARD,
)
GO_ON = ("unavailable", "too_many_requests")  # problems after which the same form is sent again
KEPT = ("task", "method", "licence", "season", *DESCRIPTION, *CARD)  # of a form that comes back


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
                texts, files = await read_form(request)
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
            names = ("task", "method", "request_id", "licence", "season")
            task, method, request_id, licence, season = (texts[name].strip() for name in names)
            draft = Draft(task, method, request_id, licence, season or None)
            words = {name: texts[name].strip().replace("\r", "") for name in DESCRIPTION}
            draft = dataclasses.replace(draft, **words)
            card = card_of(texts, len(files))
            with state.desk.place(str(owner.submitter)):
                submission = await hand_all_in(request, owner, draft, files, card)
        except Problem as problem:
            return await run_in_threadpool(come_back, site, request, texts, problem)
        return RedirectResponse(f"/submissions/{submission.id}", 303)

    return router


async def read_form(
    request: Request, names: Sequence[str] = FIELDS
) -> tuple[dict[str, str], list[bytes]]:
    """Return a form's texts, empty where it lacks one, and its files.

    Raises:
        Problem: It is no form of this page.
    """
    try:
        async with request.form(max_files=MOST, max_fields=len(names)) as form:
            texts = {name: form.get(name, "") for name in names}
            sent = [file for file in form.getlist("file") if not isinstance(file, str)]
            files = [await file.read() for file in sent]
    except (HTTPException, ClientDisconnect):
        raise Problem(
            "invalid",
            f"this is no form of this page, has more than {MOST} files, or came too slowly",
        ) from None
    words = {
        name: text.replace("\0", "") if isinstance(text, str) else ""
        for name, text in texts.items()
    }
    return words, files


def card_of(texts: Mapping[str, str], files: int) -> Card | None:
    """Return the card of an entry of so many files; None for a single robot.

    Raises:
        Problem: A single robot has a card, or a number of the card is none.
    """
    given = {name: texts[name].strip() for name in CARD}
    if files < LEAST:
        if any(given.values()):
            raise Problem(
                "invalid",
                f"there is {files} file and a card; an entry has {LEAST} to {MOST} files. Choose "
                "all of them at once, or leave the card empty for a single robot",
            )
        return None
    numbers = {}
    for name in ("steps", "trained"):
        try:
            numbers[name] = int(given[name].replace(",", "").replace(" ", ""))
        except ValueError:
            raise Problem(
                "invalid",
                f"{name} is {given[name][:40]!r}; the card of an entry of {files} files needs a "
                "whole number there",
            ) from None
    return Card(numbers["steps"], given["partners"], given["code"], numbers["trained"])


async def hand_all_in(
    request: Request, owner: Principal, draft: Draft, files: Sequence[bytes], card: Card | None
) -> Submission:
    """Hand in a single robot, or declare an entry and hand in its seeds; return the last one.

    A seed that is refused ends its entry, and is returned. The same form sent again goes on where
    it ended.
    """
    if not files or not all(files):
        raise Problem("invalid", "choose a file that is not empty, or several that are not")
    if card is None:
        return await hand_in(request, owner, dataclasses.replace(draft, data=files[0]))
    service, names = request.app.state.service, [sha256(data) for data in files]
    season = await run_in_threadpool(season_id, service, draft.season)
    words = draft.task, draft.method, draft.request
    declaration = Declaration(*words, tuple(names), card, season)
    request.app.state.limiter.hit(SUBMIT, owner.token)
    entry = await run_in_threadpool(service.declare, str(owner.submitter), declaration)
    draft = dataclasses.replace(draft, entry=entry)
    for name, data in zip(names, files, strict=True):
        seed = dataclasses.replace(draft, request=f"{draft.request}-{name[:16]}", data=data)
        submission = await hand_in(request, owner, seed)
        if submission.state in GONE_STATES:
            break
    return submission


def come_back(
    site: Site,
    request: Request,
    texts: dict[str, str],
    problem: Problem | None = None,
    limits: Limits | None = None,
) -> Response:
    """Answer with the form as it was filled in, and why nothing was handed in, or its limits."""
    what = "The entry was not handed in whole" if texts["steps"] else "Nothing was handed in"
    message = f"{what}: {problem.message}" if problem else ""
    values = form_values(site, {name: texts[name] for name in KEPT}, message, limits)
    if problem and problem.code in GO_ON:
        values["request_id"] = texts["request_id"]
    return site.form(request, "submit.html", CODES[problem.code] if problem else 200, **values)


def form_values(
    site: Site, texts: dict[str, str], message: str = "", limits: Limits | None = None
) -> dict[str, Any]:
    """Return the values of the form: choices, earlier inputs, and the error if it came back."""
    seasons = [season for season in site.queries.seasons() if season.state == "open"]
    empty = {"task": site.tasks[0], "method": "", "licence": LICENCES[-1], "season": ""}
    texts = empty | dict.fromkeys((*DESCRIPTION, *CARD), "") | texts
    choices = {
        "seasons": seasons,
        "licences": LICENCES,
        "limits": limits,
        "rate": SUBMIT.amount,
        "most": DESCRIPTION,
        "seeds": (LEAST, MOST),
        "form_mib": FORM_BYTES // 1024**2,
    }
    return {**choices, "given": texts, "message": message, "request_id": new_id(20)}
