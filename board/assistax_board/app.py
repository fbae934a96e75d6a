"""The application: routes, guards and pages."""

from typing import Any

from fastapi import FastAPI
from starlette.middleware import Middleware

from assistax_board.api import operations, public, submitting, working
from assistax_board.api.desk import Desk
from assistax_board.api.errors import add_error_handlers
from assistax_board.api.guards import BodyLimit, HeadAsGet
from assistax_board.api.rates import Limiter
from assistax_board.pages import add_pages
from assistax_board.pages.security import SecurityHeaders
from assistax_board.service import Service

DESCRIPTION = "Submit a robot, and be scored on partners that nobody has."
# The first has the first word.
MIDDLEWARE = (
    Middleware(SecurityHeaders),
    Middleware(HeadAsGet),
    Middleware(BodyLimit),
    Middleware(operations.Observe),
)
ROUTERS = (public.router, submitting.router, working.router, operations.router)


def create_app(service: Service, **pages: Any) -> FastAPI:
    """Return the application that serves the API and the pages; `pages` go to `add_pages`."""
    app = FastAPI(
        title="assistax-zoo",
        description=DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        middleware=list(MIDDLEWARE),
    )
    app.state.service, app.state.desk = service, Desk()
    app.state.limiter = Limiter()
    app.state.metrics, app.state.pulse = operations.Metrics(), operations.Pulse()
    for router in ROUTERS:
        app.include_router(router)
    add_error_handlers(app)
    pages.setdefault("form_key", service.signer.secret("forms"))
    add_pages(app, service, **pages)
    return app
