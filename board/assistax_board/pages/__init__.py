"""Pages for people: boards, submissions, partners, pairs, the cross-play explorer and seasons.

Rendered on the server from what `Queries` and the registry say. Everything but moving
about in the explorer works without scripts.
"""

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

from fastapi import Depends, FastAPI, Request
from starlette.responses import Response

from assistax_board.api.guards import count_page
from assistax_board.pages.boards import Boards
from assistax_board.pages.cache import PageCache, respond
from assistax_board.pages.crossplays import PUBLISHED, CrossPlays
from assistax_board.pages.methods import ZooFiles
from assistax_board.pages.rendering import static_files
from assistax_board.pages.routes.boards import board_router
from assistax_board.pages.routes.films import film_router
from assistax_board.pages.routes.labs import lab_router
from assistax_board.pages.routes.methods import method_router
from assistax_board.pages.routes.news import news_router
from assistax_board.pages.routes.organising import organiser_router
from assistax_board.pages.routes.partners import explorer_router, pair_router, partner_router
from assistax_board.pages.routes.reference import reference_router
from assistax_board.pages.routes.seasons import season_router
from assistax_board.pages.routes.submitting import submit_router
from assistax_board.pages.season_boards import SeasonBoards
from assistax_board.pages.security import FormTokens
from assistax_board.pages.site import NotFoundError, Site
from assistax_board.pages.videos import PublishedFilms, Videos, run_command
from assistax_board.store.artefacts import Artefacts
from assistax_board.store.queries import Queries
from zoo.registry import load_registry

ROUTERS = (
    *(board_router, method_router, season_router, submit_router, partner_router, pair_router),
    *(explorer_router, film_router, organiser_router, reference_router, news_router, lab_router),
)
FILMS = Path("~/.cache/assistax-zoo/films")  # where no other folder is given


class Tasks(Protocol):
    """The catalogue, as far as pages need it."""

    @property
    def tasks(self) -> tuple[str, ...]:
        """The tasks that have a board."""
        ...


class Service(Protocol):
    """Interface of the service that pages need."""

    @property
    def queries(self) -> Queries:
        """Public questions to the database."""
        ...

    @property
    def catalogue(self) -> Tasks:
        """Tasks that are scored."""
        ...

    @property
    def artefacts(self) -> Artefacts:
        """Submitted files."""
        ...

    def panel_b(self, season: str) -> Sequence[tuple[str, Any]]:
        """Return the episodes of every submission on the panel B of a closed season."""
        ...


def add_pages(
    app: FastAPI,
    service: Service,
    *,
    films: Path | None = None,
    crossplays: Path | None = None,
    registry: Path | None = None,
    form_key: bytes | None = None,
) -> None:
    """Add the pages to an application.

    Args:
        app: the application.
        service: the service.
        films: folder in which films of pairs are kept; one of this user's if not given.
        crossplays: folder with a finished cross-play for each task; the published ones of a
            checkout if neither it nor a registry is given.
        registry: file that partners are read from; the installed one if not given.
        form_key: signs tokens of forms; the same one for all processes behind one address.
    """
    folder = (films or FILMS).expanduser()
    played = CrossPlays(crossplays or (PUBLISHED if registry is None else folder / "none"))
    loaded = load_registry(registry)
    videos = Videos(folder, functools.partial(run_command, registry=registry))
    zoo_files = ZooFiles(loaded)
    site = Site(
        tasks=service.catalogue.tasks,
        queries=service.queries,
        registry=loaded,
        crossplays=played,
        boards=Boards(service.queries, played, zoo_files),
        season_boards=SeasonBoards(service.queries, service.panel_b, zoo_files),
        videos=videos,
        published=PublishedFilms(loaded, videos),
        cache=PageCache(),
        tokens=FormTokens(form_key),
        read=service.artefacts.get,
        zoo_files=zoo_files,
    )
    for router in ROUTERS:
        app.include_router(router(site), dependencies=[Depends(count_page)])

    @app.get("/static/{name}", include_in_schema=False)
    def static(request: Request, name: str) -> Response:
        if name not in static_files():
            raise NotFoundError("There is no such file.")
        return respond(request, static_files()[name], immutable=True)

    def error_page(request: Request, status: int, message: str) -> Response:
        return site.fresh("error.html", request.url.path, status, message=message)

    app.state.error_page = error_page

    def not_found(request: Request, error: Exception) -> Response:
        return site.fresh("error.html", request.url.path, 404, message=str(error))

    app.add_exception_handler(NotFoundError, not_found)
