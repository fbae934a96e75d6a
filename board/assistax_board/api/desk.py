"""Checks submitted files in threads of its own, so that pages never wait."""

import asyncio
import contextlib
from collections import Counter
from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from assistax_board.problems import Problem

AT_ONCE = 2  # files that are looked at
WAITING = 16  # files that are looked at or wait for it
FORMS = 16  # forms with files that arrive, one from an address
OF_OWNER = 4  # requests of one lab, those whose bodies still arrive too


class Desk:
    """Takes robots in, a few at a time. Everything runs in the server's event loop."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="desk")
        self._owners: Counter[str] = Counter()
        self._forms: set[str] = set()  # addresses
        self._waiting = 0

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
        if self._owners[owner] >= OF_OWNER or self._waiting >= WAITING:
            raise Problem("unavailable", "many robots are being handed in; try again soon", 5)
        self._owners[owner] += 1
        try:
            yield
        finally:
            self._owners[owner] -= 1
            self._owners += Counter()  # forgets who has none

    async def run(self, function: Callable[..., Any], *args: Any) -> Any:
        """Run a function in a thread of the desk and return its result."""
        self._waiting += 1
        try:
            return await asyncio.get_running_loop().run_in_executor(self._threads, function, *args)
        finally:
            self._waiting -= 1
