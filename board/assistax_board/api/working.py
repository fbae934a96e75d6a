"""Routes of workers: take jobs, extend leases, and bring results."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Response
from pydantic import BaseModel, Field

from assistax_board.api.errors import RESPONSES
from assistax_board.api.guards import TheService, Worker, json_body
from assistax_board.api.submitting import whole_body
from assistax_board.rules.scoring import MAX_TABLE_BYTES, Work
from assistax_board.vocabulary import REFUSALS

router = APIRouter(prefix="/api/work", tags=["work"], responses=RESPONSES)

LeaseSecret = Annotated[str, Header(alias="X-Lease", min_length=1, max_length=100)]
Version = Annotated[str, Field(max_length=64)]


class LeaseRequest(BaseModel):
    """A worker's name and the versions that it scores."""

    worker: str = Field(min_length=1, max_length=80)
    versions: list[Version] = Field(max_length=100)


class Refused(BaseModel):
    """Why a robot cannot be played: a word of the vocabulary."""

    code: str = Field(pattern=f"^({'|'.join(REFUSALS)})$")


class Held(BaseModel):
    """Whether the lease is still held."""

    held: bool


class Counted(BaseModel):
    """Whether this result was the first of its identity."""

    counted: bool


_LEASE, _LEASE_BODY = json_body(LeaseRequest)
_REFUSED, _REFUSED_BODY = json_body(Refused)


@router.post("/lease", responses={204: {"description": "nothing waits"}}, openapi_extra=_LEASE_BODY)
def lease(service: TheService, worker: Worker, body: Annotated[Any, _LEASE]) -> Any:
    """Take the next job; answer 204 if the queue is empty."""
    work: Work | None = service.lease(body.worker, body.versions)
    return Response(status_code=204) if work is None else work


@router.post("/{job}/beat")
def beat(service: TheService, worker: Worker, job: str, lease: LeaseSecret) -> Held:
    """Say that the job is still being done."""
    return Held(held=service.beat(job, lease))


@router.post("/{job}/give-back", status_code=204)
def give_back(service: TheService, worker: Worker, job: str, lease: LeaseSecret) -> None:
    """Return a job undone, because this worker stops."""
    service.give_back(job, lease)


@router.post("/{job}/failed", status_code=204)
def failed(service: TheService, worker: Worker, job: str, lease: LeaseSecret) -> None:
    """Return a job that could not be done; the cause is in the worker's own log."""
    service.job_failed(job, lease)


@router.post("/{job}/refused", status_code=204, openapi_extra=_REFUSED_BODY)
def refused(
    service: TheService,
    worker: Worker,
    job: str,
    lease: LeaseSecret,
    body: Annotated[Any, _REFUSED],
) -> None:
    """End a submission whose robot cannot be played."""
    service.job_refused(job, lease, body.code)


@router.put("/{job}/result")
def result(
    service: TheService,
    worker: Worker,
    job: str,
    lease: LeaseSecret,
    body: Annotated[bytes, Depends(whole_body)],
    seconds: Annotated[float, Query(ge=0, le=1e6)],
) -> Counted:
    """Bring a result; one that is there already is not counted again."""
    return Counted(counted=service.result(job, lease, body[: MAX_TABLE_BYTES + 1], seconds))


@router.get("/artefacts/{sha256}", response_class=Response)
def artefact(service: TheService, worker: Worker, sha256: str) -> Response:
    """Return a robot or a packed private release."""
    return Response(service.artefacts.get(sha256), media_type="application/octet-stream")
