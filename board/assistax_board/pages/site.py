"""Base of all pages: their sources, their cache and their responses."""

import dataclasses
from collections.abc import Callable
from typing import Any

from starlette.requests import Request
from starlette.responses import Response

from assistax_board.api.guards import MADE, client_of
from assistax_board.pages.boards import Boards
from assistax_board.pages.cache import HTML, Page, PageCache, pack, respond
from assistax_board.pages.crossplays import CrossPlay, CrossPlays
from assistax_board.pages.methods import ZooFiles
from assistax_board.pages.rendering import render
from assistax_board.pages.season_boards import SeasonBoards
from assistax_board.pages.security import FIELD, FormTokens
from assistax_board.pages.videos import PublishedFilms, Videos
from assistax_board.rules.catalogue import public_entries
from assistax_board.store.played import describe_partners, partners_in_words
from assistax_board.store.queries import Queries
from assistax_board.store.shown import Submission
from zoo.registry import Registry

LIVE = 1.0  # seconds that a page of the database may be old
STILL = 60.0  # a page of published files


class NotFoundError(Exception):
    """Error of a missing page; its text names the thing and the place to look."""


@dataclasses.dataclass(frozen=True)
class Site:
    """The parts that pages are made of."""

    tasks: tuple[str, ...]  # that have a board
    queries: Queries
    registry: Registry
    crossplays: CrossPlays
    boards: Boards
    season_boards: SeasonBoards
    videos: Videos
    published: PublishedFilms
    cache: PageCache
    tokens: FormTokens
    read: Callable[[str], bytes]  # a file that was handed in, by its sha256
    zoo_files: ZooFiles

    def met_by(self, submission: Submission) -> str | None:
        """Return the words for a published ego's training side; None for another robot."""
        ego = self.zoo_files.of(submission.task).get(submission.artefact or "")
        met = ego.trained_against if ego else None
        return f"the training side of {met.split}" if met else None

    def task(self, task: str) -> str:
        """Return the task if there is one of this name."""
        if task not in self.tasks:
            raise NotFoundError(f"There is no task {task!r}; there are {', '.join(self.tasks)}.")
        return task

    def public_in_words(self, task: str) -> str:
        """Return the public half of a task in words: its partners and version."""
        entries = public_entries(self.registry, task)
        return partners_in_words(describe_partners(self.registry, entries))

    def crossplay(self, task: str) -> CrossPlay:
        """Return a task's cross-play."""
        crossplay = self.crossplays.of(self.task(task))
        if crossplay is None:
            raise NotFoundError(f"There is no cross-play of {task} on this server yet.")
        return crossplay

    def submission(self, id: str) -> Submission:
        """Return a submission."""
        submission = self.queries.submission(id)
        if submission is None:
            raise NotFoundError(f"There is no submission {id!r}; look for it on its task's board.")
        return submission

    def page(
        self,
        request: Request,
        key: str,
        seconds: float,
        template: str,
        values: Callable[[], dict[str, Any]],
        media_type: str = HTML,
        *,
        limited: bool = False,
    ) -> Response:
        """Answer with a page, rendered at most every few seconds for all its readers.

        `key` names the page by all of the request that it depends on. Of `limited` pages one
        address gets few that nobody has read before.
        """
        name = f"{template} {key}"
        if limited and self.cache.lacks(name):
            request.app.state.limiter.hit(MADE, client_of(request))

        def rendered() -> str:
            return self.render(template, request.url.path, **values())

        page = self.cache.page(name, seconds, rendered, media_type, limited=limited)
        return respond(request, page)

    def render(self, template: str, path: str, **values: Any) -> str:
        """Return a page with the values that every page shows."""
        return render(template, tasks=self.tasks, path=path, **values)

    def form(self, request: Request, template: str, status: int = 200, **values: Any) -> Response:
        """Answer with a page that has a form for this browser alone."""
        response = Response(status_code=status, headers={"Cache-Control": "no-store"})
        token = self.tokens.issue(request, response)
        values |= {"field": FIELD, "token": token}
        response.body = self.render(template, request.url.path, **values).encode()
        response.headers["Content-Length"] = str(len(response.body))
        response.headers["Content-Type"] = "text/html; charset=utf-8"
        return response

    def fresh(self, template: str, path: str, status: int = 200, **values: Any) -> Response:
        """Return a private page, which no cache may store."""
        page: Page = pack(self.render(template, path, **values).encode())
        return Response(page.body, status, {"Cache-Control": "no-store"}, page.media_type)
