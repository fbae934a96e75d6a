"""Output of the commands: JSON on standard output, progress and messages on standard error."""

import json
import math
import re
import shlex
import shutil
import sys
import threading
import time
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from assistax_base.errors import counted, printable
from assistax_envs.stdout import stdout_is_data as stdout_is_data

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.play.progress import Progress
    from population.runs.train import Progress as TrainingProgress

SECONDS_BETWEEN_LINES = 10.0
SECONDS_OF_COMPILING = 110.0  # without a word; XLA warns of a slow compilation after 120
MOST_LINES = 20  # of one kind, such as problems
_COMMAND: list[str] = []


def remember_command(words: Sequence[str]) -> None:
    """Keep the words after the program's name, for `command_line`."""
    _COMMAND[:] = words


def command_line() -> str:
    """Return the command that runs, as it would be typed."""
    return shlex.join(["assistax-zoo", *_COMMAND])


def print_json(value: Any) -> None:
    """Print one JSON document on standard output; NaN and infinities become null.

    What a terminal would obey, or could not show, is escaped as JSON escapes it.
    """
    text = json.dumps(_plain(value), indent=2, ensure_ascii=False)
    print("\n".join(_escaped(line) for line in text.split("\n")), flush=True)


def answer(json: bool, content: Any, *lines: str) -> None:
    """Print the answer of a command: one JSON document, or lines for a reader.

    Received text may be in a line: a terminal obeys none of it. What may hold line breaks is made
    `printable` where it enters a line.
    """
    if json:
        print_json(content)
    else:
        print("\n".join(map(_harmless, lines)))


def first_lines(start: str, texts: Sequence[str], what: str) -> list[str]:
    """Return a line for each of the first texts, and a line with the count of the rest.

    A folder that was received may have hundreds of thousands of problems.

    Args:
        start: Beginning of each line.
        texts: All of them.
        what: One of them is called so.
    """
    lines = [f"{start}{text}" for text in texts[:MOST_LINES]]
    if len(texts) > MOST_LINES:
        more = counted(len(texts) - MOST_LINES, f"more {what}")
        lines.append(f"and {more}; --json prints all")
    return lines


def confirm(question: str, changes: Sequence[str], yes: bool) -> bool:
    """Show changes and return whether the user takes them. Without a terminal, do not ask."""
    print(*(printable(f"  {change}") for change in changes), sep="\n", file=sys.stderr)
    if yes or not sys.stdin.isatty():
        return yes
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def new_table(title: str) -> "Table":
    """Return an empty table that fits 80 columns."""
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))


def print_table(table: "Table") -> None:
    """Print a table, 80 columns wide if there is no terminal."""
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
        with _lines(description, total, is_bytes) as advance:
            yield advance


@contextmanager
def step_progress(description: str, total: int) -> Generator[Callable[[int], None]]:
    """Show how many of `total` environment steps are played; yield `advance(n)` for each n more."""
    from evaluation.play.progress import Progress

    with StudyLine(description) as line:
        done = 0

        def advance(count: int) -> None:
            nonlocal done
            done += count
            line(Progress(done, total, 0.0, what=""))

        yield advance


def chosen_progress(
    progress: bool | Callable[..., None] | None,
    shown: AbstractContextManager[Callable[..., None]],
) -> AbstractContextManager[Callable[..., None] | None]:
    """Return a run's progress reporter: `shown` if True, the function given, or None."""
    return shown if progress is True else nullcontext(progress or None)


@contextmanager
def _bar(description: str, total: int, is_bytes: bool) -> Generator[Callable[[int], None]]:
    from rich.console import Console
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
    with Progress(*columns, console=Console(stderr=True), expand=True) as bar:
        task = bar.add_task(description, total=total)
        yield lambda count: bar.advance(task, count)


@contextmanager
def _lines(description: str, total: int, is_bytes: bool) -> Generator[Callable[[int], None]]:
    start, done = time.monotonic(), 0
    first: tuple[float, int] | None = None  # when work was first told of, and how much of it

    def figures() -> str:
        if is_bytes:
            return f"{done / 1e6:.1f}/{total / 1e6:.1f} MB"
        return f"{done / 1e6:.2f}/{total / 1e6:.2f} M" if total >= 1e5 else f"{done}/{total}"

    def advance(count: int) -> None:
        nonlocal done, first
        done += count
        now = time.monotonic()
        text = f"{description}: {figures()}, {now - start:.0f} s"
        # Compilation comes before it, and is not part of the speed; nor is word that work begins.
        first = first or ((now, done) if done else None)
        # Of a twentieth on, since another program may compile between two of the first counts.
        if first and done - first[1] >= total / 20:
            text += f", {(now - first[0]) * (total - done) / (done - first[1]):.0f} s left"
        line.show(text, last=done >= total)

    with Line() as line:
        yield advance


class Line:
    """Shows the progress of work: on one line that changes, or on a line every ten seconds."""

    def __init__(self, shown: float | None = None) -> None:
        """Wait before the first line, unless `shown`, the time of the last one, is long ago."""
        notebook = type(sys.stderr).__name__ == "OutStream"  # ipykernel's
        self._live, self._open = notebook or sys.stderr.isatty(), False
        self._shown = time.monotonic() if shown is None else shown
        self._word: threading.Timer | None = None  # about a compilation

    def compiles(self, *, now: bool) -> None:
        """Say in good time, if a compilation takes so long that XLA warns, that this is no error.

        Args:
            now: Whether programs are compiled from now on, or no longer.
        """
        if self._word:
            self._word.cancel()
        self._word = threading.Timer(SECONDS_OF_COMPILING, self._explain) if now else None
        if self._word:
            self._word.daemon = True
            self._word.start()

    def _explain(self) -> None:
        start, self._open = "\n" if self._open else "", False
        text = "still compiling; XLA may now warn of a very slow compile, which is no error"
        print(f"{start}{text}", file=sys.stderr, flush=True)

    def show(self, text: str, *, last: bool) -> None:
        """Show the text, unless another was shown just now and more will come."""
        pause = 0.5 if self._live else SECONDS_BETWEEN_LINES
        if last or time.monotonic() - self._shown >= pause:
            self._shown, self._open = time.monotonic(), self._live
            start, end = ("\r", "\x1b[K") if self._live else ("", "\n")
            if sys.stderr.isatty():  # a line that wraps could not be written over
                text = text[-(shutil.get_terminal_size().columns - 1) :]
            print(f"{start}{text}", end=end, file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """End the line, so that later output starts on a line of its own."""
        self.compiles(now=False)
        if self._open:
            print(file=sys.stderr, flush=True)


class StudyLine(Line):
    """Shows the progress of an evaluation, stage by stage, on one clock."""

    def __init__(self, description: str) -> None:
        super().__init__(-math.inf)
        self._description, self._began = description, time.monotonic()
        self._stage: tuple[int, str] | None = None
        # When the stage's first steps were done, and how many: compilation is no part of the speed.
        self._first: tuple[float, int] | None = None

    def __call__(self, progress: "Progress") -> None:
        if not progress.total:
            return
        if (stage := (progress.stage, progress.what)) != self._stage:
            self._stage, self._first, self._shown = stage, None, -math.inf
            self.compiles(now=True)
        work = self._description
        work += f", {progress.stage} of {progress.stages}" if progress.stages > 1 else ""
        work += f", {progress.what}" if progress.what else ""
        now, steps = time.monotonic(), "compiling"
        if progress.done:
            steps = f"{_count(progress.done)} of {_count(progress.total)} steps"
            self._first = self._first or (now, progress.done)
            self.compiles(now=False)
        text = f"{work}: {steps}, {now - self._began:.0f} s"
        # Of a twentieth on, since another program may compile between two of the first counts.
        if self._first and (played := progress.done - self._first[1]) >= progress.total / 20:
            left = (now - self._first[0]) * (progress.total - progress.done) / played
            of = " of this stage" if progress.stages > 1 else ""
            text += f", {_duration(left)} left{of}" if left else ""
        self.show(text, last=progress.done >= progress.total)


class TrainingLine(Line):
    """Shows the progress of a training; a `progress` of the training functions."""

    def __init__(self, name: str) -> None:
        super().__init__(-math.inf)
        self._name, self._return = name, ""

    def __enter__(self) -> Self:
        """Begin: the first update compiles, and only then there is progress to tell."""
        self.compiles(now=True)
        return self

    def __call__(self, progress: "TrainingProgress") -> None:
        self.compiles(now=False)
        mean = progress.rows["return"].mean()
        self._return = self._return if mean is None else f"return {mean:.1f}"
        reward = f"reward {progress.rows['reward'].mean():.2f} a step, no whole episode yet"
        left, speed = progress.seconds_left, f"{progress.steps_per_second:,.0f} steps/s, "
        text = (
            f"{self._name}: {_count(progress.steps)} of {_count(progress.total_steps)} steps, "
            f"{'' if left is None else speed}{self._return or reward}"
            f"{'' if left is None else f', {_duration(left)} left'}"
        )
        self.show(text, last=progress.update == progress.updates)


def _count(steps: int) -> str:
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if steps >= size:
            return f"{steps / size:.2f}{unit}"
    return str(steps)


def _duration(seconds: float) -> str:
    if seconds >= 3600:
        return f"{seconds // 3600:.0f} h {seconds % 3600 // 60:.0f} min"
    return f"{seconds // 60:.0f} min" if seconds >= 120 else f"{seconds:.0f} s"


def _harmless(text: str) -> str:
    """Replace control characters. Keep line breaks, and the bold type of our tables."""
    parts = re.split("(\n|\033\\[[01]m)", text)
    return "".join(part if i % 2 else printable(part) for i, part in enumerate(parts))


def _escaped(line: str) -> str:
    """Escape unprintable characters in a line of JSON. Only its strings have them."""
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in line)


def _plain(value: Any) -> Any:
    """Turn NumPy scalars and arrays, paths, sets and tuples into values of JSON."""
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
    return None if isinstance(value, float) and not math.isfinite(value) else value
