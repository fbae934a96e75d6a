"""A server on loopback, in a thread of this process."""

import contextlib
import dataclasses
import itertools
import os
import threading
import time
from collections.abc import Callable, Generator
from typing import Any

import uvicorn
from fastapi import FastAPI

from assistax_board.app import create_app
from assistax_board.client import Client
from assistax_board.serve import config_of, listen
from assistax_board.service import Service
from assistax_board.vocabulary import Scope

SOON = 60.0  # seconds, also where many others use the machine
_PLACES = itertools.count(389 * os.getpid())  # of other processes: elsewhere


def port_of_its_own() -> int:
    """Return a port that stays free until its server is there, and while that starts again.

    It is below those that the system gives to whoever asks for any.
    """
    while True:
        port = 20_000 + next(_PLACES) % 12_000
        with contextlib.suppress(ValueError), listen("127.0.0.1", port):
            return port


def soon(condition: Callable[[], Any], seconds: float = SOON) -> bool:
    """Wait until a condition holds; return False if it does not in time."""
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


@dataclasses.dataclass
class Served:
    """A running server, and the clients that end with it."""

    service: Service
    address: str
    clients: list[Client] = dataclasses.field(default_factory=list)

    def client(self, scope: Scope, submitter: str = "lab", patience: float = 30.0) -> Client:
        name = submitter if scope == "submit" else None
        token = self.service.create_token((scope,), submitter=name)
        self.clients.append(Client(self.address, token, patience=patience))
        return self.clients[-1]


@contextlib.contextmanager
def serving(
    app: FastAPI,
    port: int = 0,
    proxy: str | None = None,
    kind: Callable[[uvicorn.Config], uvicorn.Server] = uvicorn.Server,
    host: str = "127.0.0.1",
) -> Generator[str]:
    """Serve an application until the block ends, and yield its address."""
    config = config_of(app, proxy)
    config.lifespan, config.log_level = "off", "error"
    server = kind(config)
    with listen(host, port) as (port, listeners):
        thread = threading.Thread(target=server.run, args=(listeners,))
        thread.start()
        while not server.started:
            assert thread.is_alive(), "it has not started"
            time.sleep(0.01)
        try:
            yield f"http://127.0.0.1:{port}"
        finally:
            server.should_exit = True
            server.force_exit = True
            thread.join()


@contextlib.contextmanager
def served(service: Service, **options: Any) -> Generator[Served]:
    """Serve a service until the block ends; see `serving`."""
    with serving(create_app(service), **options) as address:
        running = Served(service, address)
        try:
            yield running
        finally:
            for client in running.clients:
                client.close()
