"""Pages of methods: one method's history and partners, and all methods with every partner."""

from typing import Any

import numpy as np
from fastapi import APIRouter, Request
from starlette.responses import Response

from assistax_board.pages.boards import Board
from assistax_board.pages.charts import axis_over
from assistax_board.pages.routes.films import film_values
from assistax_board.pages.routes.rows import board_of, columns_of, has_settings
from assistax_board.pages.site import LIVE, Site
from assistax_board.store.shown import Submission

COLUMNS = 20  # methods beside one another; the best ones
SHADES = 10  # classes of the style sheet
_NEWEST = 200  # submissions of a method's history


def method_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/submissions/{id}/method")
    def method(request: Request, id: str) -> Response:
        def values() -> dict[str, Any]:
            return method_values(site, site.submission(id))

        return site.page(request, id, LIVE, "method.html", values)

    @router.get("/tasks/{task}/heatmap")
    def heatmap(request: Request, task: str, version: str = "") -> Response:
        def values() -> dict[str, Any]:
            board = board_of(site, task, version)
            return {"task": task, "board": board, **heatmap_values(board)}

        return site.page(request, f"{task} {version}", LIVE, "heatmap.html", values)

    return router


def method_values(site: Site, submission: Submission) -> dict[str, Any]:
    """Return the values of the page of a submission's method."""
    board = site.boards.of(submission.task)
    row = board.of(submission.id) if board else None
    fared = board.care.get(row[0].name, {}) if board and row else {}
    scores = site.queries.scores(method_of=submission.id)
    shown = [score for score in scores if "mean" in score.figures]
    ends = [end for score in shown for end in score.figures.get("mean_ci") or ()]
    history = site.queries.submissions(method_of=submission.id, limit=_NEWEST)
    described = (entry for entry in history if entry.about or entry.link or entry.citation)
    return {
        "submission": submission,
        "described": next(described, None),  # as the newest that says anything does
        "row": row,
        "fared": fared,
        "has_settings": has_settings(board),
        "care": columns_of({"": fared}),
        "history": history,
        **film_values(site, submission),
        "scores": {
            id: [score for score in shown if score.submission == id]
            for id in {score.submission for score in shown}
        },
        "axis": axis_over([*ends, *(score.figures["mean"] for score in shown)]),
        "version": board.version if board else None,
        **(partner_values(board, row[1].returns.mean(axis=2)) if board and row else {"pairs": []}),
    }


def partner_values(board: Board, returns: np.ndarray) -> dict[str, Any]:
    """Return each partner with its returns in columns [C, P], and their shades.

    The partner with which they earn least comes first.
    """
    low, high = float(returns.min()), float(returns.max())
    shades = ((SHADES - 1) * (returns - low) / ((high - low) or 1.0)).round().astype(int)
    pairs = [
        (
            board.partners[i],
            float(returns[:, i].mean()),
            list(zip(returns[:, i].tolist(), shades[:, i].tolist(), strict=True)),
        )
        for i in np.argsort(returns.mean(axis=0), kind="stable")
    ]
    return {"pairs": pairs, "low": low, "high": high}


def heatmap_values(board: Board) -> dict[str, Any]:
    """Return the best methods' mean returns with every partner."""
    methods = (board.methods or board.rows)[:COLUMNS]
    returns = np.stack([played.returns.mean(axis=(0, 2)) for _, played in methods])
    return {"methods": methods, **partner_values(board, returns)}
