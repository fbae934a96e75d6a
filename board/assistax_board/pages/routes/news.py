"""New scores and seasons as Atom feeds."""

import time
from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from assistax_board.pages.rendering import figure, interval, moment, words
from assistax_board.pages.site import STILL, Site
from assistax_board.store.shown import Score, Season
from assistax_board.vocabulary import REFERENCE

ENTRIES = 50  # of a feed
_READ = 500  # scores that are read for them: an upgrade scores everything again
ATOM = "application/atom+xml; charset=utf-8"


def news_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    def feed(request: Request, task: str | None) -> Response:
        def values() -> dict[str, Any]:
            entries = news(site, task and site.task(task))
            return {"task": task, "entries": entries, "address": request.url.path}

        return site.page(request, task or "", STILL, "news.atom", values, ATOM)

    @router.get("/news.atom")
    def all_news(request: Request) -> Response:
        return feed(request, None)

    @router.get("/tasks/{task}/news.atom")
    def task_news(request: Request, task: str) -> Response:
        return feed(request, task)

    return router


def news(site: Site, task: str | None) -> list[dict[str, str]]:
    """Return the entries of the feed, the newest first; a submission has one entry."""
    scores = {
        (score.submission, score.panel): score
        for score in site.queries.scores(task=task, newest=_READ)
        if score.submitter != REFERENCE and "mean" in score.figures
    }
    entries = [_of_score(score) for score in scores.values()]
    entries += [entry for season in site.queries.seasons(task) for entry in _of_season(season)]
    return sorted(entries, key=lambda entry: entry["updated"], reverse=True)[:ENTRIES]


def _of_score(score: Score) -> dict[str, str]:
    panel = "public partners" if score.panel == "public" else f"hidden panel {score.panel}"
    within = interval(score.figures.get("mean_ci"))
    return {
        "id": f"submission/{score.submission}/{score.panel}",
        "link": f"/submissions/{score.submission}",
        "updated": _timestamp(score.created_at),
        "title": f"{score.method} by {score.submitter} on {words(score.task)}: "
        f"{figure(score.figures['mean'])} with {panel}",
        "text": f"95% interval {within}." if within else "",
    }


def _of_season(season: Season) -> list[dict[str, str]]:
    happened = {"opened": season.opened_at, "closed": season.closed_at}
    return [
        {
            "id": f"season/{season.id}/{event}",
            "link": f"/seasons/{season.id}",
            "updated": _timestamp(at),
            "title": f"Season {season.name} of {words(season.task)} {event}",
            "text": f"{season.budget} attempts each. It closes {moment(season.closes_at)}."
            if event == "opened" and season.closes_at
            else "",
        }
        for event, at in happened.items()
        if at is not None
    ]


def _timestamp(at: float) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(at))
