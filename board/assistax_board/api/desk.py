"""Checks submitted files in threads of its own, so that pages never wait."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Generator, Hashable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from assistax_board.problems import Problem

AT_ONCE = 2  # files that are looked at
WAITING = 16  # files that are looked at or wait for it
FORMS = 16  # forms with files that arrive, one from an address
ANSWER_SECONDS = 45.0  # after which a client hears something: it waits for a minute
OF_OWNER = 4  # requests of one lab, those whose bodies still arrive too


class Desk:
    """Takes robots in, a few at a time. Everything runs in the server's event loop."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="desk")
        self._owners: Counter[str] = Counter()
        self._forms: set[str] = set()  # addresses
        self._running: dict[Hashable, asyncio.Future] = {}  # that are looked at or wait for it

    @contextlib.contextmanager
    def form(self, client: str) -> Generator[None]:
        """Keep a place for a form whose sender is unknown until it is read.

        Raises:
            Problem: Too many arrive now, or one from this address.
        """
        if client in self._forms or len(self._forms) >= FORMS:
            raise Problem("unavailable", "many forms are being sent; try again soon", 5)
        self._forms.add(client)
        try:
            yield
        finally:
            self._forms.remove(client)

    @contextlib.contextmanager
    def place(self, owner: str) -> Generator[None]:
        """Keep a place for a request of a lab while the block runs.

        Raises:
            Problem: Too many wait; whoever asks again soon has a turn.
        """
        if self._owners[owner] >= OF_OWNER or len(self._running) >= WAITING:
            raise Problem("unavailable", "many robots are being handed in; try again soon", 5)
        self._owners[owner] += 1
        try:
            yield
        finally:
            self._owners[owner] -= 1
            self._owners += Counter()  # forgets who has none

    async def run(self, function: Callable[..., Any], *args: Any, name: Hashable = None) -> Any:
        """Run a function in a thread of the desk and return its result.

        Whoever asks again by the same name while it runs waits for the same result.

        Raises:
            Problem: It takes long; it goes on meanwhile.
        """
        work = self._running.get(name) if name is not None else None
        if work is None:
            loop = asyncio.get_running_loop()
            work = loop.run_in_executor(self._threads, function, *args)
            key = work if name is None else name
            self._running[key] = work
            work.add_done_callback(lambda done: self._forget(key, done))
        await asyncio.wait([work], timeout=ANSWER_SECONDS)
        if not work.done():
            raise Problem(
                "unavailable", "your file is still being looked at; send the same request again", 5
            )
        return work.result()

    def _forget(self, key: Hashable, done: asyncio.Future) -> None:
        del self._running[key]
        if not done.cancelled():
            done.exception()  # its client may have left
