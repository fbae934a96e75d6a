"""What anybody may read: boards, submissions, seasons, the ledger and the key of receipts."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel

from assistax_board.api.errors import RESPONSES
from assistax_board.api.guards import count_read
from assistax_board.problems import Problem
from assistax_board.rules import seasons
from assistax_board.store.queries import (
    STATEMENT,
    Attempts,
    LedgerEntry,
    PartnerScore,
    Score,
    Season,
    Submission,
)

router = APIRouter(
    prefix="/api", tags=["read"], responses=RESPONSES, dependencies=[Depends(count_read)]
)

Word = Annotated[str | None, Query(max_length=80)]
Limit = Annotated[int, Query(ge=1, le=1000)]


class About(BaseModel):
    """What this server is."""

    statement: str
    tasks: list[str]
    key: str  # of receipts, base64


class Board(BaseModel):
    """Released scores of one task and version, and what a reader must know beside them."""

    statement: str
    version: str | None
    scores: list[Score]


@router.get("/about")
def about(request: Request) -> About:
    """Return the tasks, the key that signs receipts, and what a board does not mean."""
    service = request.app.state.service
    tasks, key = list(service.catalogue.tasks), service.signer.public_key
    return About(statement=STATEMENT, tasks=tasks, key=key)


@router.get("/boards/{task}")
def board(request: Request, task: str, season: Word = None, version: Word = None) -> Board:
    """Return the scores of a task: by the newest version, if no other is asked for."""
    queries, season = request.app.state.service.queries, season_id(request, season)
    check_task(request, task)
    versions = [name for name, _ in queries.versions(task)]
    if version is not None and version not in versions:
        raise Problem("not_found", f"no scores of version {version!r}; GET /api/about first")
    chosen = version or next(iter(versions), None)
    scores = queries.scores(task=task, season=season, version=chosen) if chosen else []
    return Board(statement=STATEMENT, version=chosen, scores=scores)


@router.get("/submissions")
def submissions(
    request: Request, task: Word = None, season: Word = None, limit: Limit = 100
) -> list[Submission]:
    """Return the newest submissions first."""
    season = season_id(request, season)
    if task is not None:
        check_task(request, task)
    return request.app.state.service.queries.submissions(task=task, season=season, limit=limit)


@router.get("/submissions/{id}")
def submission(request: Request, id: str) -> Submission:
    """Return one submission: its state, its place in the queue, and what became of it."""
    return _found(request.app.state.service.queries.submission(id), "submission")


@router.get("/submissions/{id}/scores")
def scores(request: Request, id: str) -> list[Score]:
    """Return what was released of a submission, by panel and version."""
    submission(request, id)
    return request.app.state.service.queries.scores(submission=id)


@router.get("/submissions/{id}/partners")
def partners(request: Request, id: str, version: Word = None) -> list[PartnerScore]:
    """Return every return of the public half."""
    submission(request, id)
    return request.app.state.service.queries.partner_scores([id], version)


@router.get("/submissions/{id}/receipt")
def receipt(request: Request, id: str) -> dict[str, Any]:
    """Return the signed receipt of a scored submission."""
    return _found(request.app.state.service.queries.receipt(id), "receipt")


@router.get("/seasons")
def all_seasons(request: Request, task: Word = None) -> list[Season]:
    """Return the seasons, the newest first."""
    if task is not None:
        check_task(request, task)
    return request.app.state.service.queries.seasons(task)


@router.get("/seasons/{id}")
def season(request: Request, id: str) -> Season:
    """Return one season, by its id or its name."""
    return _found(request.app.state.service.queries.season(id), "season")


@router.get("/seasons/{id}/attempts")
def attempts(request: Request, id: str) -> list[Attempts]:
    """Return who has made how many attempts."""
    return request.app.state.service.queries.attempts(season(request, id).id)


@router.get("/seasons/{id}/revealed")
def revealed(request: Request, id: str) -> dict[str, Any]:
    """Return the leaves of a closed season, with which anybody proves its root."""
    return seasons.revealed(request.app.state.service.database, id)


@router.get("/seasons/{id}/release", response_class=Response)
def release(request: Request, id: str) -> Response:
    """Return the partners of a closed season, packed."""
    service = request.app.state.service
    data = seasons.revealed_release(service.database, service.artefacts, id)
    return Response(data, media_type="application/zip")


@router.get("/ledger")
def ledger(
    request: Request, after: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0, limit: Limit = 1000
) -> list[LedgerEntry]:
    """Return the entries of the ledger behind number `after`."""
    return request.app.state.service.queries.ledger(after, limit)


def check_task(request: Request, task: str) -> None:
    """Refuse a task that has no board and never had one."""
    service = request.app.state.service
    if task not in service.catalogue.tasks and not service.queries.versions(task):
        names = ", ".join(service.catalogue.tasks)
        raise Problem("not_found", f"no task {task!r}; there are {names}")


def season_id(request: Request, season: str | None) -> str | None:
    """Return the id of a season that is given by id or name."""
    if season is None:
        return None
    found = request.app.state.service.queries.season(season)
    if found is None:
        raise Problem("not_found", f"no season {season!r}; GET /api/seasons lists them")
    return found.id


def _found(value: Any, what: str) -> Any:
    if value is None:
        raise Problem("not_found", f"no such {what}")
    return value
