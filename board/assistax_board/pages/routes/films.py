"""Films of robots that were handed in, each with the same published partner of its task."""

from pathlib import Path
from typing import Any

from fastapi import APIRouter, Form, Request
from starlette.responses import FileResponse, RedirectResponse, Response

from assistax_board.api.guards import FILMS, client_of
from assistax_board.pages import security
from assistax_board.pages.site import NotFoundError, Site
from assistax_board.pages.videos import HandedIn, Pair
from assistax_board.store.shown import Submission

_KINDS = {".gif": "image/gif", ".mp4": "video/mp4", ".episode": "application/octet-stream"}
SCORING_ALONE = "evaluation-only"  # the licence that allows nothing but scoring


def film_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/submissions/{id}/film")
    def film(request: Request, id: str) -> Response:
        submission = site.submission(id)
        robot_of(site, submission)
        values = film_values(site, submission)
        return site.form(request, "robot_film.html", submission=submission, **values)

    @router.post("/submissions/{id}/film")
    def ask(
        request: Request, id: str, form_token: str = Form(default="", alias=security.FIELD)
    ) -> Response:
        return ask_for(site, request, robot_of(site, site.submission(id)), form_token)

    @router.get("/submissions/{id}/film/file")
    def file(id: str) -> Response:
        # Browsers ask anew each time: the lab may take its robot back.
        return film_file(site.videos.film(robot_of(site, site.submission(id)).key), "no-cache")

    @router.get("/submissions/{id}/film/episode")
    def episode(id: str) -> Response:
        key = robot_of(site, site.submission(id)).key
        return film_file(site.videos.episode(key), "no-cache")

    return router


def ask_for(site: Site, request: Request, filmed: Any, form_token: str) -> Response:
    """Ask for a film by a form, and go back to its page."""
    if not site.tokens.accepts(request, form_token):
        return site.fresh("error.html", request.url.path, 403, message=security.NOT_OURS)
    if site.videos.state(filmed) in ("none", "failed"):
        request.app.state.limiter.hit(FILMS, client_of(request))
    if site.videos.ask(filmed) == "full":
        message = "Many films are waiting already. Please ask again in some minutes."
        return site.fresh("error.html", request.url.path, 503, message=message)
    return RedirectResponse(request.url.path, 303)


def film_file(path: Path | None, cache: str) -> Response:
    """Answer with a film, which browsers may keep as `cache` says.

    Raises:
        NotFoundError: It is not there.
    """
    if path is None:
        raise NotFoundError("There is no such film; ask for it on the page of its robot.")
    return FileResponse(path, headers={"Cache-Control": cache}, media_type=_KINDS[path.suffix])


def film_values(site: Site, submission: Submission) -> dict[str, Any]:
    """Return the values of a robot's film; its state is None if it is not filmed."""
    try:
        filmed = robot_of(site, submission)
    except NotFoundError:
        return {"state": None, "film": None, "episode": None}
    path, address = site.videos.film(filmed.key), f"/submissions/{submission.id}/film"
    return {
        "state": site.videos.state(filmed),
        "film": f"{address}/file" if path else None,
        "episode": f"{address}/episode" if site.videos.episode(filmed.key) else None,
        "is_gif": path is not None and path.suffix == ".gif",
        "partner": filmed.human,
    }


def robot_of(site: Site, submission: Submission) -> HandedIn | Pair:
    """Return a robot as it is filmed: with a public partner of the training side, always the same.

    Raises:
        NotFoundError: It is not filmed, and why.
    """
    if submission.reference is not None:
        if pair := site.published.pair(submission.task, submission.reference):
            return pair
        raise NotFoundError("This row is no published robot, so it is not filmed.")
    file = submission.artefact
    if submission.state != "scored" or file is None:
        raise NotFoundError("Only robots that were handed in as files and scored are filmed.")
    if submission.licence == SCORING_ALONE:
        raise NotFoundError("This robot's licence allows scoring alone, so it is not filmed.")
    if not site.queries.is_kept(file):
        raise NotFoundError("This robot's file is not here any more, so it cannot be filmed.")
    if (human := site.published.human(submission.task)) is None:
        raise NotFoundError(
            "All public partners count in the score, so there is none to film with."
        )
    version = site.registry.env_version(human)
    return HandedIn(submission.task, file, human.id, human.sha256, version, site.read)
