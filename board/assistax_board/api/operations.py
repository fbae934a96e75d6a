"""Health, metrics and logs, without secrets and without values of hidden partners."""

import asyncio
import json
import logging
import math
import time
from typing import Any

import sqlalchemy as sa
from fastapi import APIRouter, Depends, Request, Response
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from assistax_board.api.guards import TheService, count_read
from assistax_board.store import schema
from assistax_board.store.database import Database

router = APIRouter(tags=["operate"])
log = logging.getLogger("assistax_board")
FRESH = 0.5  # seconds that an answer of the database is good for
METHODS = ("GET", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "CONNECT")


class JsonLines(logging.Formatter):
    """One JSON object a line, of the fields that were named and no others."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        fields = getattr(record, "fields", {})
        line = {"at": round(record.created, 3), "level": record.levelname.lower()}
        return json.dumps({**line, "event": record.getMessage(), **fields})


class Metrics:
    """Metrics for a monitoring system."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        name = "assistax_service_"
        labels = ("method", "route", "status")
        self.requests = Counter(f"{name}requests", "HTTP requests", labels, registry=self.registry)
        self.seconds = Histogram(
            f"{name}request_seconds", "Time to answer", ("route",), registry=self.registry
        )
        self.jobs = Gauge(f"{name}jobs", "Jobs by state", ("state",), registry=self.registry)
        self.submissions = Gauge(
            f"{name}submissions", "Submissions by state", ("state",), registry=self.registry
        )

    def read(self, connection: sa.Connection) -> None:
        """Count jobs and submissions."""
        for gauge, table in ((self.jobs, schema.jobs), (self.submissions, schema.submissions)):
            gauge.clear()
            state = table.c.state
            counts = sa.select(state, sa.func.count()).group_by(state)
            for name, count in connection.execute(counts):
                gauge.labels(name).set(count)


class Pulse:
    """Asks the database whether it answers, at most once in `FRESH` for all clients.

    A crowd of a thousand that asks at once would else hold all threads and connections.
    """

    def __init__(self) -> None:
        self._asked: asyncio.Future[None] | None = None
        self._at = -math.inf

    async def feel(self, database: Database) -> None:
        """Return if the database answers, or did a moment ago; raise its error if it does not."""
        now = time.monotonic()
        if self._asked is None or (self._asked.done() and now - self._at > FRESH):
            self._asked, self._at = asyncio.ensure_future(asyncio.to_thread(_ask, database)), now
        await asyncio.shield(self._asked)  # a client that leaves does not end it for the others


def _ask(database: Database) -> None:
    with database.read() as connection:
        connection.execute(sa.select(1))


@router.get("/api/health")
async def health(request: Request) -> dict[str, str]:
    """Answer while the process and its database do."""
    await request.app.state.pulse.feel(request.app.state.service.database)
    return {"status": "ok"}


@router.get("/metrics", response_class=Response, dependencies=[Depends(count_read)])
def metrics(service: TheService, request: Request) -> Response:
    """Return metrics in Prometheus's text format."""
    counted: Metrics = request.app.state.metrics
    with service.database.read() as connection:
        counted.read(connection)
    return Response(generate_latest(counted.registry), media_type="text/plain; version=0.0.4")


class Observe:
    """ASGI middleware: a request is counted, timed and logged by its route.

    Its query, headers and body never are.
    """

    def __init__(self, app: Any) -> None:
        self._app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Pass a request on, and look at its answer."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        status, began = 0, time.perf_counter()

        async def seen(message: Any) -> None:
            nonlocal status
            status = message.get("status", status)
            await send(message)

        await self._app(scope, receive, seen)
        if status:  # otherwise the client was gone before
            _note(scope, status, time.perf_counter() - began)


def _note(scope: Any, status: int, seconds: float) -> None:
    route = getattr(scope.get("route"), "path", "none")
    # Anybody may invent methods, and what is counted by name stays in memory.
    method = scope["method"] if scope["method"] in METHODS else "other"
    metrics: Metrics = scope["app"].state.metrics
    metrics.requests.labels(method, route, status).inc()
    metrics.seconds.labels(route).observe(seconds)
    token = scope.get("state", {}).get("token")
    fields = {"method": method, "route": route, "status": status, "token": token}
    log.info("request", extra={"fields": {**fields, "ms": round(1000 * seconds, 1)}})


def log_to_stderr() -> None:
    """Write the service's log to standard error, as lines of JSON."""
    handler = logging.StreamHandler()
    handler.setFormatter(JsonLines())
    log.addHandler(handler)
    log.propagate = False
    log.setLevel(logging.INFO)
