"""The page of a lab: its rows on the public boards and its scored submissions, nothing else."""

from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from assistax_board.pages.site import LIVE, NotFoundError, Site

_NEWEST, _MOST = 50, 50  # submissions and rows of a kind that are listed
_EVERY = 10_000  # submissions of one lab


def lab_router(site: Site) -> APIRouter:
    """Return the route."""
    router = APIRouter(include_in_schema=False)

    @router.get("/labs/{name:path}")
    def lab(request: Request, name: str) -> Response:
        def values() -> dict[str, Any]:
            return lab_values(site, name)

        return site.page(request, name, LIVE, "lab.html", values, limited=True)

    return router


def lab_values(site: Site, name: str) -> dict[str, Any]:
    """Return the values of a lab's page, all of which boards and submissions' pages show too.

    Raises:
        NotFoundError: No submission of such a lab was scored.
    """
    scored = site.queries.submissions(scored_of=name, limit=_EVERY)
    if not scored:
        raise NotFoundError(f"No robot of a lab {name[:80]!r} was scored; boards have the names.")
    tasks = [task for task in site.tasks if any(row.task == task for row in scored)]
    boards = {task: site.boards.of(task) for task in tasks}
    rows = [
        (task, standing, played)
        for task, board in boards.items()
        for standing, played in (board.rows if board else ())
        if played.newest.submitter == name
    ]
    return {
        "name": name,
        "entries": [row for row in rows if not row[2].is_single],
        "singles": [row for row in rows if row[2].is_single],
        "scored": [row for row in scored if row.task in tasks],
        "most": _MOST,
        "newest": _NEWEST,
        "care": {task: board.care for task, board in boards.items() if board},
        "behind": any(site.boards.is_behind(task) for task in tasks),
    }
