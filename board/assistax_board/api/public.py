"""Public routes: boards, submissions, seasons, the ledger and the key of receipts."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel

from assistax_board.api.errors import RESPONSES, existing
from assistax_board.api.guards import TheService, count_read
from assistax_board.problems import Problem
from assistax_board.rules import seasons
from assistax_board.service import Service
from assistax_board.store.queries import STATEMENT
from assistax_board.store.shown import (
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
    """Description of this server."""

    statement: str
    tasks: list[str]
    key: str  # of receipts, base64


class Board(BaseModel):
    """Released scores of one task and version, with the notes that a reader needs."""

    statement: str
    version: str | None
    scores: list[Score]


@router.get("/about")
def about(service: TheService) -> About:
    """Return the tasks, the key that signs receipts, and the limits of a board's meaning."""
    tasks, key = list(service.catalogue.tasks), service.signer.public_key
    return About(statement=STATEMENT, tasks=tasks, key=key)


@router.get("/boards/{task}")
def board(service: TheService, task: str, season: Word = None, version: Word = None) -> Board:
    """Return the scores of a task: by the version served, if no other is asked for."""
    queries, season = service.queries, season_id(service, season)
    check_task(service, task)
    versions = [name for name, _ in queries.versions(task)]
    if version is not None and version not in versions:
        raise Problem("not_found", f"no scores of version {version!r}; GET /api/about first")
    chosen = version or next(iter(versions), None)
    scores = queries.scores(task=task, season=season, version=chosen) if chosen else []
    return Board(statement=STATEMENT, version=chosen, scores=scores)


@router.get("/submissions")
def submissions(
    service: TheService, task: Word = None, season: Word = None, limit: Limit = 100
) -> list[Submission]:
    """Return the newest submissions first."""
    season = season_id(service, season)
    if task is not None:
        check_task(service, task)
    return service.queries.submissions(task=task, season=season, limit=limit)


@router.get("/submissions/{id}")
def submission(service: TheService, id: str) -> Submission:
    """Return one submission: its state, its place in the queue, and its result."""
    return existing(service.queries.submission(id), "submission")


@router.get("/submissions/{id}/scores")
def scores(service: TheService, id: str) -> list[Score]:
    """Return the released scores of a submission, by panel and version."""
    submission(service, id)
    return service.queries.scores(submission=id)


@router.get("/submissions/{id}/partners")
def partners(service: TheService, id: str, version: Word = None) -> list[PartnerScore]:
    """Return every return of the public half."""
    submission(service, id)
    return service.queries.partner_scores([id], version)


@router.get("/submissions/{id}/receipt")
def receipt(service: TheService, id: str) -> dict[str, Any]:
    """Return the signed receipt of a scored submission."""
    return existing(service.queries.receipt(id), "receipt")


@router.get("/seasons")
def all_seasons(service: TheService, task: Word = None) -> list[Season]:
    """Return the seasons, the newest first."""
    if task is not None:
        check_task(service, task)
    return service.queries.seasons(task)


@router.get("/seasons/{id}")
def season(service: TheService, id: str) -> Season:
    """Return one season, by its id or its name."""
    return existing(service.queries.season(id), "season")


@router.get("/seasons/{id}/attempts")
def attempts(service: TheService, id: str) -> list[Attempts]:
    """Return the number of attempts of each submitter."""
    return service.queries.attempts(season(service, id).id)


@router.get("/seasons/{id}/revealed")
def revealed(service: TheService, id: str) -> dict[str, Any]:
    """Return the leaves of a closed season, with which anybody proves its root."""
    return seasons.revealed(service.database, id)


@router.get("/seasons/{id}/release", response_class=Response)
def release(service: TheService, id: str) -> Response:
    """Return the partners of a closed season, packed."""
    data = seasons.revealed_release(service.database, service.artefacts, id)
    return Response(data, media_type="application/zip")


@router.get("/ledger")
def ledger(
    service: TheService, after: Annotated[int, Query(ge=0, le=2**31 - 1)] = 0, limit: Limit = 1000
) -> list[LedgerEntry]:
    """Return the entries of the ledger behind number `after`."""
    return service.queries.ledger(after, limit)


def check_task(service: Service, task: str) -> None:
    """Refuse a task that has no board and never had one."""
    if task not in service.catalogue.tasks and not service.queries.versions(task):
        names = ", ".join(service.catalogue.tasks)
        raise Problem("not_found", f"no task {task!r}; there are {names}")


def season_id(service: Service, season: str | None) -> str | None:
    """Return the id of a season that is given by id or name."""
    if season is None:
        return None
    row = service.queries.season(season)
    if row is None:
        raise Problem("not_found", f"no season {season!r}; GET /api/seasons lists them")
    return row.id
