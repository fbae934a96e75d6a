"""Health, metrics and logs. None of them holds a secret or a value of a hidden partner."""

import json
import logging
import time
from collections.abc import Awaitable, Callable

import sqlalchemy as sa
from fastapi import APIRouter, Request, Response
from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from assistax_board.api.guards import TheService
from assistax_board.store import schema

router = APIRouter(tags=["operate"])
log = logging.getLogger("assistax_board")


class JsonLines(logging.Formatter):
    """One JSON object a line, of the fields that were named and no others."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record."""
        fields = getattr(record, "fields", {})
        line = {"at": round(record.created, 3), "level": record.levelname.lower()}
        return json.dumps({**line, "event": record.getMessage(), **fields})


class Metrics:
    """What a monitoring system reads."""

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


@router.get("/api/health")
def health(service: TheService) -> dict[str, str]:
    """Answer while the process and its database do."""
    with service.database.read() as connection:
        connection.execute(sa.select(1))
    return {"status": "ok"}


@router.get("/metrics", response_class=Response)
def metrics(service: TheService, request: Request) -> Response:
    """Return metrics in Prometheus's text format."""
    counted: Metrics = request.app.state.metrics
    with service.database.read() as connection:
        counted.read(connection)
    return Response(generate_latest(counted.registry), media_type="text/plain; version=0.0.4")


async def observe(
    request: Request, call_next: Callable[[Request], Awaitable[Response]]
) -> Response:
    """Count, time and log a request by its route: never its query, headers or body."""
    began = time.perf_counter()
    response = await call_next(request)
    seconds = time.perf_counter() - began
    route = getattr(request.scope.get("route"), "path", "none")
    metrics: Metrics = request.app.state.metrics
    metrics.requests.labels(request.method, route, response.status_code).inc()
    metrics.seconds.labels(route).observe(seconds)
    fields = {
        "method": request.method,
        "route": route,
        "status": response.status_code,
        "ms": round(1000 * seconds, 1),
        "token": getattr(request.state, "token", None),
    }
    log.info("request", extra={"fields": fields})
    return response


def log_to_stderr() -> None:
    """Write the service's log to standard error, as lines of JSON."""
    handler = logging.StreamHandler()
    handler.setFormatter(JsonLines())
    log.addHandler(handler)
    log.propagate = False
    log.setLevel(logging.INFO)
