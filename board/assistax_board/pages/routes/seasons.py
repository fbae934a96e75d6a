"""Pages of submissions, seasons and the ledger."""

import json
import time
from collections.abc import Sequence
from typing import Any

from fastapi import APIRouter, Request
from starlette.responses import Response

from assistax_board.pages.charts import axis_over
from assistax_board.pages.methods import group_methods
from assistax_board.pages.rendering import table_rows
from assistax_board.pages.routes.films import film_values
from assistax_board.pages.routes.rows import being_computed, columns_of
from assistax_board.pages.site import LIVE, NotFoundError, Site
from assistax_board.store.played import OF_OWN_FAMILY, partners_in_words, statement_of
from assistax_board.store.shown import Score, Season, Submission

_ENTRIES = 200  # of the ledger on one page
LAST_ENTRY = 2**31 - 1  # that a database counts to


def season_router(site: Site) -> APIRouter:
    """Return the routes."""
    router = APIRouter(include_in_schema=False)

    @router.get("/submissions/{id}")
    def submission(request: Request, id: str) -> Response:
        def values() -> dict[str, Any]:
            return submission_values(site, site.submission(id))

        return site.page(request, id, LIVE, "submission.html", values)

    @router.get("/submissions/{id}/standing.json")
    def standing(id: str) -> dict[str, Any]:
        submission = site.submission(id)
        board = site.boards.of(submission.task)
        row = board.of(id) if board else None
        if row is None and site.boards.is_behind(submission.task):
            raise being_computed(submission.task)
        if board is None or row is None:
            raise NotFoundError("It has no place yet: its score is not there.")
        competing = sum(played.competes for _, played in board.rows)
        page = f"/tasks/{submission.task}"
        place, lowest = row[0].place, row[0].lowest
        answer = {"board_place": place, "board_lowest": lowest}
        return answer | {"of_methods": competing, "board": page}

    @router.get("/submissions/{id}/receipt.json")
    def receipt(id: str) -> Response:
        receipt = site.queries.receipt(site.submission(id).id)
        if receipt is None:
            raise NotFoundError("There is no receipt yet: it is signed when the score is shown.")
        headers = {"Content-Disposition": 'attachment; filename="receipt.json"'}
        return Response(json.dumps(receipt, indent=2), 200, headers, "application/json")

    @router.get("/seasons")
    def seasons(request: Request) -> Response:
        return site.page(
            request, "", LIVE, "seasons.html", lambda: {"seasons": site.queries.seasons()}
        )

    @router.get("/seasons/{id}")
    def season(request: Request, id: str) -> Response:
        return site.page(request, id, LIVE, "season.html", lambda: season_values(site, id))

    @router.get("/ledger")
    def ledger(request: Request, after: int = 0) -> Response:
        start = min(max(after, 0), LAST_ENTRY)

        def values() -> dict[str, Any]:
            entries = site.queries.ledger(start, _ENTRIES)
            return {"entries": entries, "after": start, "page_size": _ENTRIES}

        return site.page(request, str(start), LIVE, "ledger.html", values)

    return router


def submission_values(site: Site, submission: Submission) -> dict[str, Any]:
    """Return the values of a submission's page."""
    versions = [id for id, _ in site.queries.versions(submission.task)]
    scores = site.queries.scores(submission=submission.id)
    board = site.boards.of(submission.task) if submission.state == "scored" else None
    receipt = site.queries.receipt(submission.id)
    partners = site.queries.partner_scores([submission.id], versions[0]) if versions else []
    means = [sum(partner.returns) / len(partner.returns) for partner in partners]
    season = site.queries.season(submission.season) if submission.season else None
    return {
        "submission": submission,
        "waits": submission.state == "queued" and submission.place is None,
        "season": season,
        "plays": played_rows(site, submission.task, season),
        "row": board.of(submission.id) if board else None,
        "met": site.met_by(submission),
        "own": _own_figures(scores, versions),
        "comparable": board is not None and len(board.rows) > 1,
        "scores": sorted(scores, key=lambda score: (-score.created_at, score.panel)),
        "newest": versions[0] if versions else None,
        "key": receipt["content"].get("key", "KEY") if receipt else None,
        "receipt": table_rows(receipt["content"]) if receipt else None,
        "partners": sorted(zip(partners, means, strict=True), key=lambda pair: pair[1]),
        "axis": axis_over(means),
        "has_film": film_values(site, submission)["state"] is not None,
    }


def _own_figures(scores: Sequence[Score], versions: Sequence[str]) -> dict[str, Any] | None:
    """Return this robot's score on the public panel under the board's version."""
    newest = [
        s.figures for s in scores if s.panel == "public" and [s.version] == list(versions[:1])
    ]
    return newest[0] if newest else None


def season_values(site: Site, id: str) -> dict[str, Any]:
    """Return the values of a season's page: its rules, attempts and released scores."""
    season = site.queries.season(id)
    if season is None:
        raise NotFoundError(f"There is no season {id!r}; see the list of seasons.")
    rows = site.season_boards.of(season)
    drawn = [row for row, entry in rows if not entry.is_reference] or [row for row, _ in rows]
    return {
        "season": season,
        "statement": statement_of(season.hidden),
        "plays": played_rows(site, season.task, season),
        "now": time.time(),
        "attempts": {row.submitter: row for row in site.queries.attempts(season.id)},
        "entered": _entered(site, season.id),
        "unplayed": [site.submission(id) for id in sorted(site.queries.unplayed(season.id))],
        "panel_a": best_of_each(site.queries.scores(season=season.id), "A"),
        "rows": rows,
        "has_own_family": OF_OWN_FAMILY in (season.hidden or {}).get("persons", {}),
        "groups": list(rows[0][0].by_group) if rows else [],
        "is_behind": site.season_boards.is_behind(season),
        "axis": axis_over(end for row in drawn for end in row.m_test.mean_ci or (row.m_test.mean,)),
        "care": columns_of({entry.newest.id: entry.care for _, entry in rows}),
    }


def played_rows(site: Site, task: str, season: Season | None) -> list[tuple[str, str]]:
    """Return rows of name and value about the public and the hidden partners."""
    rows = [("public half", site.public_in_words(task))]
    return rows if season is None else [*rows, ("hidden", partners_in_words(season.hidden))]


def _entered(site: Site, season: str) -> dict[str, list[Submission]]:
    """Return a robot of each method that a lab chose for panel B, by lab."""
    chosen = site.queries.submissions(season=season, limit=100_000)
    entered: dict[str, list[Submission]] = {}
    for group in group_methods(seed for seed in chosen if seed.entered):
        entered.setdefault(group[-1].submitter, []).append(group[-1])
    return entered


def best_of_each(scores: Sequence[Score], panel: str) -> list[Score]:
    """Return each method's highest released score on a panel, the highest first."""
    best: dict[tuple[str, str], Score] = {}
    for score in (
        candidate
        for candidate in scores
        if candidate.panel == panel and "mean" in candidate.figures
    ):
        kept = best.get((score.submitter, score.method))
        if kept is None or score.figures["mean"] > kept.figures["mean"]:
            best[score.submitter, score.method] = score
    return sorted(best.values(), key=lambda score: (-score.figures["mean"], score.submitter))
