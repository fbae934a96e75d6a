"""Pages of scores: the tasks, a task's board, and two of its methods side by side."""

import functools
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request
from starlette.responses import Response

from assistax_board.pages.boards import Board
from assistax_board.pages.cache import respond
from assistax_board.pages.charts import axis_over
from assistax_board.pages.routes.rows import (
    LAST,
    LONGEST,
    SORTS,
    View,
    board_csv,
    board_of,
    columns_of,
    groups_of,
    has_settings,
    old_version,
)
from assistax_board.pages.site import LIVE, NotFoundError, Site
from assistax_board.pages.videos import Shown
from evaluation.figures.metrics import group_weights, paired_difference


def board_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/")
    def home(request: Request) -> Response:
        def values() -> dict[str, Any]:
            boards = {task: site.boards.of(task) for task in site.tasks}
            return {
                "boards": boards,
                "behind": {task for task in boards if site.boards.is_behind(task)},
                "seasons": site.queries.seasons(),
                "played": site.crossplays.tasks,
                "films": published_films(site),
            }

        return site.page(request, "", LIVE, "home.html", values)

    @router.get("/tasks/{task}.csv")
    def table(request: Request, task: str, version: str = "") -> Response:
        def text() -> str:
            return board_csv(board_of(site, task, version))

        page = site.cache.page(f"board.csv {task} {version}", LIVE, text, "text/csv; charset=utf-8")
        response = respond(request, page)
        response.headers["Content-Disposition"] = f'attachment; filename="{site.task(task)}.csv"'
        return response

    @router.get("/tasks/{task}")
    def board(
        request: Request,
        task: str,
        version: str = "",
        sort: str = "",
        search: Annotated[str, Query(max_length=LONGEST)] = "",
        show: str = "",
        page: Annotated[int, Query(ge=1, le=LAST)] = 1,
    ) -> Response:
        view = View(sort, search, show, page)

        def values() -> dict[str, Any]:
            return board_values(site, task, old_version(site, task, version), view)

        key = f"{task} {version} {view}"
        return site.page(request, key, LIVE, "board.html", values, limited=view != View())

    @router.get("/tasks/{task}/compare")
    def compare(request: Request, task: str, a: str = "", b: str = "") -> Response:
        def values() -> dict[str, Any]:
            board = board_of(site, task, "")
            return {"task": task, "board": board, **compare_values(board, a, b)}

        key = f"{task} {a} {b}"
        return site.page(request, key, LIVE, "compare.html", values, limited=bool(a or b))

    return router


def published_films(site: Site) -> dict[str, list[Shown]]:
    """Return the films of published robots by task; the first call asks for each."""
    films: dict[str, list[Shown]] = {}
    for submission in site.queries.published():
        if submission.task in site.tasks and (shown := site.published.shown(submission)):
            films.setdefault(submission.task, []).append(shown)
    return films


def board_values(site: Site, task: str, version: str | None, view: View) -> dict[str, Any]:
    """Return the values of a board's page; the default version is the one served."""
    board = site.boards.of(task, version)
    care = columns_of(board.care) if board else {}
    rows = board.rows if board else ()
    # Rows to measure by are far away and would press the others into one point.
    drawn = [row for row, played in rows if not played.is_reference] or [row for row, _ in rows]
    ends = [end for row in drawn for end in row.m_test.mean_ci or (row.m_test.mean,)]
    waiting = site.queries.submissions(task=task, waiting=True)
    return {
        "task": task,
        "board": board,
        "listed": view.of(board) if board else None,
        "singles": view.singles(board) if board else None,
        "view": view,
        "sorts": SORTS | groups_of(board) | care,
        "old_version": version,
        "versions": site.queries.versions(task),
        "fared": board.care if board else {},
        "care": care,
        "groups": groups_of(board),
        "has_settings": has_settings(board),
        "is_behind": site.boards.is_behind(task, version),
        "axis": axis_over(ends),
        "waiting": sorted((row for row in waiting if row.place), key=lambda row: row.place or 0),
        "seasons": site.queries.seasons(task),
        "has_crossplay": task in site.crossplays.tasks,
    }


@functools.lru_cache(maxsize=64)  # a board is computed anew when a score is added, and only then
def compare_values(board: Board, a: str, b: str) -> dict[str, Any]:
    """Return the paired difference of two methods, each named by one of its submissions.

    Without names they are the two that stand highest.
    """
    rows = [row for row in (board.of(id) for id in (a, b) if id) if row]
    if len(rows) < len([id for id in (a, b) if id]):
        raise NotFoundError("One of the two is not on this board; choose from its list.")
    for row in (*board.methods, *board.rows):
        if len(rows) < 2 and all(row is not leader for leader in rows):
            rows.append(row)
    if len(rows) < 2 or rows[0] is rows[1]:
        return {"first": rows[0], "second": None}
    first, second = (played.returns.mean(axis=2) for _, played in rows)
    weights = 1.0 if board.groups is None else group_weights(board.groups)
    differences = first.mean(axis=0) - second.mean(axis=0)
    return {
        "first": rows[0],
        "second": rows[1],
        "found": paired_difference(first * weights, second * weights),
        "axis": axis_over(differences.tolist(), around=0.0),
        "pairs": [
            (
                board.partners[i],
                float(first[:, i].mean()),
                float(second[:, i].mean()),
                float(difference),
            )
            for i, difference in sorted(enumerate(differences), key=lambda pair: -pair[1])
        ],
        "groups": _by_disability(board, differences),
    }


def _by_disability(board: Board, differences: np.ndarray) -> list[tuple[str, int, float]]:
    settings = np.array([partner.disability for partner in board.partners])
    return [
        (name, int((settings == name).sum()), float(differences[settings == name].mean()))
        for name in sorted(set(settings.tolist()))
    ]
