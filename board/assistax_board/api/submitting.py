"""Routes of submitters: declare, hand in and withdraw."""

import dataclasses
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request
from pydantic import BaseModel, ConfigDict, Field

from assistax_board.api.errors import RESPONSES, existing
from assistax_board.api.guards import SUBMIT, Submitter, TheService, count_read, json_body
from assistax_board.api.public import season_id
from assistax_board.cards import Card
from assistax_board.rules.entries import Declaration
from assistax_board.rules.submissions import DESCRIPTION, MAX_BYTES, Draft
from assistax_board.rules.tokens import Principal
from assistax_board.store.played import plays_in_words
from assistax_board.store.shown import Attempts, Limits, SeasonLimit, Submission

router = APIRouter(prefix="/api", tags=["submit"], responses=RESPONSES)

LISTED = 10_000  # submissions of one lab
Text = Annotated[str, Query(min_length=1, max_length=80)]
Words = Annotated[str | None, Query(max_length=max(DESCRIPTION.values()))]
_FILE = {
    "requestBody": {
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
    }
}


class _CardBody(BaseModel):
    """A lab's word on an entry."""

    model_config = ConfigDict(extra="forbid")
    steps: int
    partners: str
    code: str
    trained: int


class EntryBody(BaseModel):
    """An entry before its files are sent; `files` are their sha256."""

    model_config = ConfigDict(extra="forbid")
    request_id: str = Field(min_length=8, max_length=64)
    task: str = Field(max_length=80)
    method: str = Field(max_length=80)
    files: list[str] = Field(max_length=100)
    card: _CardBody
    season: str | None = Field(None, max_length=80)


class DeclaredEntry(BaseModel):
    """The entry, to name when its files are sent."""

    id: str


_ENTRY, _ENTRY_API = json_body(EntryBody)


async def whole_body(request: Request) -> bytes:
    """Return the body; `BodyLimit` has bounded it."""
    return await request.body()


@router.post("/submissions", status_code=201, openapi_extra=_FILE)
async def submit(
    request: Request,
    principal: Submitter,
    task: Text,
    method: Text,
    request_id: Annotated[str, Query(min_length=8, max_length=64)],
    licence: Text = "evaluation-only",
    season: Annotated[str | None, Query(max_length=80)] = None,
    about: Words = None,
    link: Words = None,
    citation: Words = None,
    entry: Annotated[str | None, Query(max_length=32)] = None,
) -> Submission:
    """Hand in a robot: the body is its file.

    With `entry` it is a seed of an entry that was declared before; without, a single robot, which
    takes no place.

    `request_id` is chosen by you: if no answer arrives, send the same again, and it is one
    submission. `about`, `link` and `citation` are shown on the method's page.
    """
    with request.app.state.desk.place(str(principal.submitter)):
        data = await whole_body(request)
        words: dict[str, Any] = {"about": about, "link": link, "citation": citation}
        draft = Draft(task, method, request_id, licence, season, entry, data=data, **words)
        return await hand_in(request, principal, draft)


async def hand_in(request: Request, principal: Principal, draft: Draft) -> Submission:
    """Submit the draft of a token's owner and return the submission."""
    state = request.app.state
    state.limiter.hit(SUBMIT, principal.token)
    owner = str(principal.submitter)
    name = owner, draft.request
    return await state.desk.run(_hand_in, state.service, owner, draft, name=name)


@router.post("/entries", status_code=201, openapi_extra=_ENTRY_API)
def declare(
    request: Request, service: TheService, principal: Submitter, entry: Annotated[Any, _ENTRY]
) -> DeclaredEntry:
    """Declare an entry: the seeds of one method, which take a place as one.

    Then hand in each file with `entry`. It is played when all of its files are there. From its
    first score on nothing leaves it, and a file that was scored before is refused.
    """
    request.app.state.limiter.hit(SUBMIT, principal.token)
    fields = entry.model_dump(exclude={"request_id", "card", "files"})
    declaration = Declaration(
        **fields | {"season": season_id(service, entry.season or None)},
        request=entry.request_id,
        files=tuple(entry.files),
        card=Card(**entry.card.model_dump()),
    )
    return DeclaredEntry(id=service.declare(str(principal.submitter), declaration))


def _hand_in(service: Any, submitter: str, draft: Draft) -> Submission:
    draft = dataclasses.replace(draft, season=season_id(service, draft.season or None))
    return service.queries.submission(service.submit(submitter, draft))


@router.get("/limits", dependencies=[Depends(count_read)])
def limits(request: Request, principal: Submitter) -> Limits:
    """Return your limits: requests left this hour, and attempts left in open seasons."""
    return limits_of(request, principal)


@router.get("/mine", dependencies=[Depends(count_read)])
def mine(
    service: TheService,
    principal: Submitter,
    season: Annotated[str | None, Query(max_length=80)] = None,
) -> list[Submission]:
    """Return your submissions, the newest first: all, or those of a season."""
    id = season_id(service, season)
    owner = str(principal.submitter)
    return service.queries.submissions(submitter=owner, season=id, limit=LISTED)


def limits_of(request: Request, principal: Principal) -> Limits:
    """Return the limits of a token's owner; asking spends nothing."""
    state, submitter = request.app.state, str(principal.submitter)
    queries, catalogue = state.service.queries, state.service.catalogue
    seasons = [
        SeasonLimit(
            *(season.id, season.name, season.task, season.closes_at),
            *(attempts.spent, attempts.reserved, attempts.budget, attempts.left),
            plays_in_words(season.hidden, catalogue.identity(season.task).get("env_version")),
        )
        for season in queries.seasons()
        if season.state == "open"
        for attempts in queries.attempts(season.id, submitter)
        or [Attempts(submitter, 0, 0, season.budget)]
    ]
    left = state.limiter.left(SUBMIT, principal.token)
    return Limits(MAX_BYTES, SUBMIT.amount, left, tuple(seasons))


@router.post("/submissions/{id}/withdraw")
def withdraw(service: TheService, principal: Submitter, id: str) -> Submission:
    """Take a submission back; its attempt is refunded unless it met hidden partners.

    A scored single robot leaves its board; its score, its attempt and its receipt stay known. Of
    an entry all seeds go, and none once one of them has a score.
    """
    service.withdraw(id, str(principal.submitter))
    return existing(service.queries.submission(id), "submission")


@router.post("/seasons/{id}/entries")
def enter(
    service: TheService,
    principal: Submitter,
    id: str,
    submission: Annotated[list[str] | None, Query(max_length=20)] = None,
) -> list[Submission]:
    """Replace the choice of submissions for panel B and return the new choice.

    At most two methods, each named by one of its submissions, and each whole: a declared entry, or
    all single robots of one name. Without any choice it is the method that was shown last on panel
    A, of declared entries if there are any.
    """
    submitter, season = str(principal.submitter), existing(service.queries.season(id), "season")
    service.enter(season.id, submitter, submission or [])
    mine = service.queries.submissions(submitter=submitter, season=season.id, limit=1000)
    return [submission for submission in mine if submission.entered]
