"""What every command shares: JSON on standard output, progress and messages on standard error."""

import functools
import json
import math
import os
import shlex
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_envs.stdout import stdout_is_data as stdout_is_data

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from evaluation.runner import Progress

    error_console: Console

SECONDS_BETWEEN_LINES = 10.0
_COMMAND: list[str] = []


def __getattr__(name: str) -> Any:
    """Build `error_console`, a rich console on standard error, when a command first wants it."""
    if name != "error_console":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return _error_console()


def remember_command(words: Sequence[str]) -> None:
    """Keep the words after the program's name, for `command_line`."""
    _COMMAND[:] = words


def command_line() -> str:
    """Return the command that runs, as it would be typed."""
    return shlex.join(["assistax-zoo", *_COMMAND])


def cache_folder(name: str) -> Path:
    """Return the user's folder for what can be computed again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "assistax-zoo", name)


def print_json(value: Any) -> None:
    """Print one JSON document on standard output; NaN and infinities become null."""
    print(json.dumps(_plain(value), indent=2, ensure_ascii=False), flush=True)


def answer(json: bool, content: Any, *lines: str) -> None:
    """Print what a command found: one JSON document, or lines for a reader."""
    if json:
        print_json(content)
    else:
        print("\n".join(lines))


def new_table(title: str) -> "Table":
    """Return an empty table that fits 80 columns."""
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))


def print_table(table: "Table") -> None:
    """Print a table, 80 columns wide where no terminal says otherwise."""
    from rich.console import Console

    console = Console()
    (console if console.is_terminal else Console(width=80)).print(table)


@contextmanager
def progress(
    description: str, total: int, *, is_bytes: bool = False
) -> Generator[Callable[[int], None]]:
    """Show progress with the time left on standard error, in 80 columns.

    A bar on a terminal, a line that changes in a notebook, else a line every ten seconds.

    Args:
        description: What is being done, such as "evaluate scratch".
        total: Number of units of work.
        is_bytes: Show the units as megabytes.

    Yields:
        `advance(n)`, to be called whenever n units are done.
    """
    if sys.stderr.isatty():
        with _bar(description, total, is_bytes) as advance:
            yield advance
    else:
        lines = _Lines(description, total, is_bytes)
        yield lines.advance
        lines.close()


@contextmanager
def study_progress(description: str) -> Generator[Callable[["Progress"], None]]:
    """Yield a callback for `evaluation.studies`, which plays one kind of policies after another."""
    with ExitStack() as stack:
        advance: Callable[[int], None] | None = None
        shown, done = ("", 0), 0

        def show(state: "Progress") -> None:
            nonlocal advance, shown, done
            if not state.total:
                return
            if advance is None or shown != (state.what, state.total):
                advance = stack.enter_context(
                    progress(f"{description}, steps of {state.what}", state.total)
                )
                shown, done = (state.what, state.total), 0
            advance(state.done - done)
            done = state.done

        yield show


@functools.cache
def _error_console() -> "Console":
    from rich.console import Console

    return Console(stderr=True)


@contextmanager
def _bar(description: str, total: int, is_bytes: bool) -> Generator[Callable[[int], None]]:
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        Progress,
        TaskProgressColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    done = (DownloadColumn(), TransferSpeedColumn()) if is_bytes else (TaskProgressColumn(),)
    times = (TimeElapsedColumn(), "left", TimeRemainingColumn())
    columns = ("{task.description}", BarColumn(bar_width=None), *done, *times)
    with Progress(*columns, console=_error_console(), expand=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda count: bar.advance(task, count)


class _Lines:
    """Progress where no bar can be drawn; in a notebook one line that changes."""

    def __init__(self, description: str, total: int, is_bytes: bool) -> None:
        self._what, self._total, self._is_bytes = description, total, is_bytes
        self._start = self._last = time.monotonic()
        self._done, self._notebook = 0, type(sys.stderr).__name__ == "OutStream"  # ipykernel's

    def advance(self, count: int) -> None:
        self._done += count
        now = time.monotonic()
        pause = 0.5 if self._notebook else SECONDS_BETWEEN_LINES
        if now - self._last < pause and self._done < self._total:
            return
        self._last = now
        spent = now - self._start
        left = spent * (self._total - self._done) / max(self._done, 1)
        told = f"{self._what}: {self._figures()}, {spent:.0f} s, {left:.0f} s left"
        start, end = ("\r", "\x1b[K") if self._notebook else ("", "\n")
        print(f"{start}{told}", end=end, file=sys.stderr, flush=True)

    def close(self) -> None:
        if self._notebook:
            print(file=sys.stderr, flush=True)

    def _figures(self) -> str:
        if self._is_bytes:
            return f"{self._done / 1e6:.1f}/{self._total / 1e6:.1f} MB"
        if self._total >= 1e5:
            return f"{self._done / 1e6:.2f}/{self._total / 1e6:.2f} M"
        return f"{self._done}/{self._total}"


def _plain(value: Any) -> Any:
    """Turn NumPy scalars and arrays, paths, sets and tuples into what JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, set | frozenset):
        return sorted(_plain(item) for item in value)
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
