"""The application: routes, guards, and the pages if they are installed."""

import importlib.util
from typing import Any

from fastapi import FastAPI

from assistax_board.api import operations, public, submitting, working
from assistax_board.api.desk import Desk
from assistax_board.api.errors import add_error_handlers
from assistax_board.api.guards import BodyLimit, HeadAsGet, Limiter
from assistax_board.live.routes import add_live
from assistax_board.service import Service

DESCRIPTION = "Submit a robot, and be scored on partners that nobody has."


def create_app(service: Service, **pages: Any) -> FastAPI:
    """Return the application that serves the API and the pages; `pages` go to `add_pages`."""
    app = FastAPI(title="assistax-zoo", description=DESCRIPTION, docs_url=None, redoc_url=None)
    app.state.service, app.state.limiter, app.state.desk = service, Limiter(), Desk()
    for module in (public, submitting, working, operations):
        app.include_router(module.router)
    add_live(app)
    add_error_handlers(app)
    operations.add_observation(app)
    app.add_middleware(BodyLimit)
    app.add_middleware(HeadAsGet)
    if importlib.util.find_spec("assistax_board.pages"):
        importlib.import_module("assistax_board.pages").add_pages(app, service, **pages)
    return app
