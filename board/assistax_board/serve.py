"""The embedded service: one command, a folder, and workers as processes of their own."""

import asyncio
import contextlib
import ctypes
import errno
import gc
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import uvicorn
from uvicorn.protocols.http.auto import AutoHTTPProtocol

from assistax_base.locks import locked
from assistax_board.robots.limited import stop_limited
from assistax_board.rules.catalogue import ZooCatalogue
from assistax_board.service import Service
from assistax_board.store.addresses import addresses_of, extras_named, keep_addresses
from assistax_board.store.artefacts import Artefacts
from assistax_board.store.database import ONE_SERVER, Database
from assistax_board.store.receipts import load_signer
from assistax_board.vocabulary import BACKEND, TOKEN_VARIABLE

_stopping = threading.Event()
SETTLED_SECONDS = 120.0  # until references are queued
STOP_SECONDS = 20  # for requests and jobs that are under way
CONNECTIONS = 4000  # of all kinds; each may have a file beside it
LISTENERS, TAKEN = 16, 4  # connections wait at so many, which take so many in one turn
ARENA_MAX, ARENAS = -8, 2  # glibc's name of an option of malloc, and its value
TRIM_TICKS = 300  # of a tenth of a second, after which free memory is given back
SILENT_SECONDS = 10.0  # a connection may say nothing, or half a request
TAKING_LOOKS = 30  # times that long, a client may take for an answer
MISSING = errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT  # what a machine says of an address it lacks
SERVER_LOCK = ".server-lock"  # in a data folder
PARENT_VARIABLE = "ASSISTAX_ZOO_PARENT"  # a local worker ends when this process is gone


def open_service(
    data: Path,
    *,
    database: str | None = None,
    artefacts: str | None = None,
    registry: Path | None = None,
    backend: str = BACKEND,
) -> Service:
    """Return the service of a data folder, its schema at the newest version.

    Args:
        data: The folder; made if it is new.
        database: URL of a new board's database, if it is not to lie in the folder, which
            remembers it.
        artefacts: Address of a new board's files, such as s3://bucket/path; so is this.
        registry: Of the public partners; the installed one if not given.
        backend: What plays the episodes, part of every score's version.

    Raises:
        ValueError: The board that is there lies elsewhere, or its database does not answer.
    """
    from assistax_board.robots.admission import Admission, robot_sizes
    from zoo.registry import load_registry

    data.mkdir(parents=True, exist_ok=True)
    data.chmod(0o700)  # robots, tokens' hashes and private releases are nobody else's business
    addresses = addresses_of(data, database, artefacts)
    with extras_named():
        opened = Database(addresses.database.render_as_string(hide_password=False))
        store = Artefacts(addresses.artefacts)
    opened.upgrade()
    keep_addresses(data, addresses)
    loaded = load_registry(registry)
    return Service(
        opened,
        store,
        ZooCatalogue(loaded, backend),
        load_signer(data),
        Admission(robot_sizes(loaded)),
    )


@contextlib.contextmanager
def only_server(data: Path) -> Generator[None]:
    """Keep other servers away from a folder while the block runs.

    Raises:
        ValueError: Another server runs on it.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(data, SERVER_LOCK))
        except ValueError:
            raise ValueError(f"another server runs on {data}; {ONE_SERVER}") from None
        yield


def add_references_later(service: Service, seconds: float = SETTLED_SECONDS) -> threading.Timer:
    """Queue the reference rows after a while, so that first submissions come before them."""
    timer = threading.Timer(seconds, service.add_references)
    timer.daemon = True
    timer.start()
    return timer


def run_server(
    service: Service,
    listeners: list[socket.socket],
    stop_workers: Callable[[], None],
    proxy: str | None = None,
    **pages: Any,
) -> None:
    """Serve the listeners until SIGINT or SIGTERM; requests under way end first.

    `pages` go to `add_pages`.
    """
    from assistax_board.api.operations import log_to_stderr
    from assistax_board.app import create_app

    log_to_stderr()
    limit_arenas()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    enough = 2 * CONNECTIONS if hard == resource.RLIM_INFINITY else min(2 * CONNECTIONS, hard)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, enough), hard))
    _Server(config_of(create_app(service, **pages), proxy), stop_workers).run(listeners)


def limit_arenas() -> None:
    """Let all threads share two arenas of memory.

    Each of forty would else fill one of its own with what computed boards leave behind.
    """
    with contextlib.suppress(AttributeError):  # another system's library
        ctypes.CDLL(None).mallopt(ARENA_MAX, ARENAS)


def config_of(app: Any, proxy: str | None = None) -> uvicorn.Config:
    """Return an application's server settings; X-Forwarded-For of `proxy` is believed."""
    return uvicorn.Config(
        app,
        log_level="warning",
        access_log=False,  # it would hold addresses and queries; ours holds routes
        timeout_graceful_shutdown=STOP_SECONDS,
        limit_concurrency=CONNECTIONS,
        http=_IdleTimeout,
        ws="none",
        server_header=False,
        proxy_headers=proxy is not None,
        forwarded_allow_ips=proxy or "",
    )


class _IdleTimeout(AutoHTTPProtocol):  # ty: ignore[unsupported-base]
    """Closes idle connections, which would otherwise use up all there are."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._look(self, 0)

    def _look(self, seen: Any, looks: int) -> None:
        """Close a connection that was silent, or took no answer, for too long; else look again."""
        if self.transport.is_closing():
            return
        looks = looks + 1 if self.cycle is seen else 0
        waits = self.cycle is None or self.cycle.response_complete
        if looks >= (1 if waits else TAKING_LOOKS):
            self.transport.abort()
        else:
            self.loop.call_later(SILENT_SECONDS, self._look, self.cycle, looks)

    def _unsupported_upgrade_warning(self) -> None:
        """Log nothing: the request is answered as any other, and anybody may send many."""


class _Server(uvicorn.Server):
    """Stops the workers while it still answers, so that they can give their jobs back."""

    def __init__(self, config: uvicorn.Config, stop_workers: Callable[[], None]) -> None:
        super().__init__(config)
        self._stop_workers = stop_workers

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        # In a turn of the event loop uvloop takes one connection of each listener, and asyncio's
        # own loop a whole backlog: one is too few for a crowd, and a crowd holds up the loop.
        listeners, self.config.backlog = sockets or [], TAKEN
        more = [listener.dup() for listener in listeners for _ in range(LISTENERS - 1)]
        await super().startup([*listeners, *more])
        for listener in listeners:
            listener.listen(CONNECTIONS)
        gc.freeze()  # a full collection looked at all modules: a tenth of a second

    async def main_loop(self) -> None:
        if not _stopping.is_set():
            await super().main_loop()

    async def on_tick(self, counter: int) -> bool:
        if counter % TRIM_TICKS == 0:  # what a crowd left behind would stay for ever
            with contextlib.suppress(AttributeError):  # another system's library
                await asyncio.to_thread(ctypes.CDLL(None).malloc_trim, 0)
        return await super().on_tick(counter)

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await asyncio.to_thread(self._stop_workers)
        stop_limited()
        await super().shutdown(sockets)


@contextlib.contextmanager
def stopped_by_signals() -> Generator[None]:
    """End the block and its workers at Ctrl-C and at SIGTERM.

    uvicorn answers what is under way, then raises the signal once more; before it has started,
    nothing else would catch it. The wake-up pipe of other commands, which ends those within two
    seconds, is taken away.
    """
    try:
        signal.set_wakeup_fd(-1)
        _on_signals(_interrupt)
        yield
    except BaseException:  # C code that the signal struck may have made another error of it
        if not _stopping.is_set():
            raise
    finally:
        _on_signals(signal.SIG_IGN)
    if _stopping.is_set():
        # CPython remembers a KeyboardInterrupt that struck a text under `exec`, as dataclasses have
        # it, and would kill the process at its end. Another text under `exec` makes it forget that.
        exec("")
        print("stopped", file=sys.stderr, flush=True)


def _on_signals(handler: Any) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, handler)


def _interrupt(*_: Any) -> None:
    # Remembered too: an exception that strikes in a destructor is lost.
    _stopping.set()
    raise KeyboardInterrupt


@contextlib.contextmanager
def local_workers(
    count: int, address: str, token: str, options: list[str]
) -> Generator[Callable[[], None]]:
    """Run workers as processes, start them again when they die, and stop them at the end.

    Yields:
        What stops them before.
    """
    over = threading.Event()
    threads = [
        threading.Thread(target=_keep_working, args=(over, address, token, options))
        for _ in range(count)
    ]

    def stop() -> None:
        over.set()
        for thread in threads:
            if thread.is_alive():  # a signal may come before all are
                thread.join()

    try:
        for thread in threads:
            thread.start()
        yield stop
    finally:
        _on_signals(signal.SIG_IGN)  # a second one must not leave workers behind
        stop()


def _keep_working(over: threading.Event, address: str, token: str, options: list[str]) -> None:
    command = [sys.executable, "-m", "assistax_zoo", "worker", "--url", address, *options]
    environment = {**os.environ, TOKEN_VARIABLE: token, PARENT_VARIABLE: str(os.getpid())}
    while not over.is_set():
        began = time.monotonic()
        # A group of its own: Ctrl-C reaches the server alone, which then stops its workers.
        process = subprocess.Popen(command, env=environment, start_new_session=True)
        while process.poll() is None and not over.wait(0.5):
            pass
        if process.poll() is None:
            _stop(process)
        elif time.monotonic() - began < 5:
            over.wait(5)  # one that cannot start must not be started all the time


def _stop(process: Any) -> None:
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()  # its lease runs out
        process.wait()


@contextlib.contextmanager
def listen(host: str, port: int) -> Generator[tuple[int, list[socket.socket]]]:
    """Listen on each address of a host: browsers take localhost for ::1 or for 127.0.0.1.

    Yields:
        The port, which nobody else can take until the block ends (0 is a free one); what listens.

    Raises:
        ValueError: The port is taken on one of them, or the host is not this machine.
    """
    listeners: list[socket.socket] = []
    with contextlib.ExitStack() as stack:
        try:
            # IPv4 first: a machine without IPv6 may have names for its addresses all the same.
            found = {*socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)}
            for family, *_, place in sorted(found):
                try:
                    listener = socket.create_server((place[0], port, *place[2:]), family=family)
                    listeners.append(stack.enter_context(listener))
                except OSError as error:
                    if not listeners or error.errno not in MISSING:
                        raise
                port = listeners[0].getsockname()[1]
        except OSError as error:
            raise ValueError(
                f"cannot listen on {host}:{port} ({error.strerror}); choose another port"
            ) from error
        yield port, listeners
