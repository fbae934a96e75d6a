"""What every command shares: JSON on standard output, progress and messages on standard error."""

import functools
import json
import math
import os
import shlex
import sys
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_envs.stdout import stdout_is_data as stdout_is_data

if TYPE_CHECKING:
    from rich.console import Console

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
    """Print one JSON document on standard output; NaN and infinities become null, which JSON has no word for."""
    print(json.dumps(_plain(value), indent=2, ensure_ascii=False), flush=True)


@contextmanager
def progress(
    description: str, total: int, *, is_bytes: bool = False
) -> Generator[Callable[[int], None]]:
    """Show progress with the time left on standard error: a bar on a terminal, else a line every ten seconds.

    Args:
        description: What is being done, such as "evaluate scratch".
        total: Number of units of work.
        is_bytes: Show the units as bytes, and their speed.

    Yields:
        `advance(n)`, to be called whenever n units are done.
    """
    if sys.stderr.isatty():
        with _bar(description, total, is_bytes) as advance:
            yield advance
    else:
        yield _lines(description, total, is_bytes)


@functools.cache
def _error_console() -> "Console":
    from rich.console import Console

    return Console(stderr=True)


@contextmanager
def _bar(description: str, total: int, is_bytes: bool) -> Generator[Callable[[int], None]]:
    from rich.progress import (
        BarColumn,
        DownloadColumn,
        MofNCompleteColumn,
        Progress,
        TimeElapsedColumn,
        TimeRemainingColumn,
        TransferSpeedColumn,
    )

    done = (DownloadColumn(), TransferSpeedColumn()) if is_bytes else (MofNCompleteColumn(),)
    times = (TimeElapsedColumn(), "left", TimeRemainingColumn())
    with Progress(
        "{task.description}", BarColumn(), *done, *times, console=_error_console()
    ) as bar:
        task = bar.add_task(description, total=total)
        yield lambda count: bar.advance(task, count)


def _lines(description: str, total: int, is_bytes: bool) -> Callable[[int], None]:
    start = last = time.monotonic()
    done = 0

    def advance(count: int) -> None:
        nonlocal done, last
        done += count
        now = time.monotonic()
        if now - last < SECONDS_BETWEEN_LINES and done < total:
            return
        last = now
        left = (now - start) * (total - done) / max(done, 1)
        figures = f"{done / 1e6:.1f}/{total / 1e6:.1f} MB" if is_bytes else f"{done}/{total}"
        print(
            f"{description}: {figures}, {now - start:.0f} s, {left:.0f} s left",
            file=sys.stderr,
            flush=True,
        )

    return advance


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
