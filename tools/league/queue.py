"""Queue of a league's rows on the GPUs of one host, several rows side by side on each card."""

import dataclasses
import itertools
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

from tools.league.parts import Part
from tools.league.rows import named

ROW = (sys.executable, "-m", "tools.league", "row")
BESIDE = 8.0  # GB of a process beside JAX's pool: its kernels, and CUDA
TRIES = 2
LOGS = "logs"


@dataclasses.dataclass(frozen=True)
class Queued:
    """Row that waits: the words of `row`, and the GB that JAX takes for it."""

    gigabytes: float
    words: tuple[str, ...]

    @property
    def row(self) -> str:
        """Name of the row."""
        return self.words[0]

    @property
    def task(self) -> str:
        """Task of the row."""
        return self.words[1]

    @property
    def of_training_side(self) -> bool:
        """Whether it plays with the training side, together with all other rows of its task."""
        return "--side train" in " ".join(self.words)

    @property
    def part(self) -> Part | None:
        """Part of its seeds that it trains; None for all."""
        asked = dict(itertools.pairwise(self.words)).get("--part")
        return Part.parse(asked) if asked else None

    @property
    def name(self) -> str:
        """Name of its log."""
        side = "-training-side" * self.of_training_side
        return f"{self.task}-{self.row}{side}" + (f"-{self.part.name}" if self.part else "")

    def needs(self, other: "Queued") -> bool:
        """Return whether another row must be finished first."""
        if self.task != other.task:
            return False
        if self.of_training_side:
            return not other.of_training_side
        if other.row != named(self.row).of:
            return False
        if other.row != self.row:
            return True
        joins = self.part is not None and self.part.joins
        return joins and other.part is not None and not other.part.joins


@dataclasses.dataclass
class _Running:
    """Row that is being made, with its process and log."""

    queued: Queued
    card: str
    process: subprocess.Popen[bytes]
    log: IO[bytes]


def read_queue(path: Path) -> list[Queued]:
    """Return the rows of a queue file; a line has the GB that JAX takes, and the words of `row`.

    Raises:
        ValueError: A line names no row. The error has its number.
    """
    found = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = shlex.split(line, comments=True)
        if not words:
            continue
        try:
            gigabytes, row, task, *options = words
            found.append(Queued(float(gigabytes), (named(row).name, task, *options)))
        except ValueError as error:
            raise ValueError(
                f"{path}, line {number} is {line!r} ({error}); write GB, row, task and options, "
                "such as: 25 gru gentle_feeding --split persons"
            ) from None
    names = [queued.name for queued in found]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise ValueError(f"{path} has {twice} twice; rows of another split need another queue")
    return found


def run_queue(
    waiting: Sequence[Queued],
    out: Path,
    cards: Mapping[str, float],
    program: Sequence[str] = ROW,
    seconds: float = 1.0,
) -> Iterator[str]:
    """Run rows, each on the card with most room, and yield a line for each event.

    A row that fails is tried once more, since a card may have been full. Finished rows are found
    finished by `row` itself, so an interrupted queue goes on by the same command.

    Args:
        waiting: The rows.
        out: Folder of the league; the rows' logs are in `logs`.
        cards: GB of each card, by its CUDA name.
        program: Words of the program that makes a row.
        seconds: Seconds between two checks.

    Raises:
        ValueError: A row fits on no card, or rows failed; says which.
    """
    for queued in waiting:
        if queued.gigabytes + BESIDE > max(cards.values()):
            raise ValueError(
                f"{queued.name} takes {queued.gigabytes:g} GB and {BESIDE:g} beside them; the "
                f"largest card has {max(cards.values()):g}: train fewer seeds at once"
            )
    left, running, failures = list(waiting), list[_Running](), dict[str, int]()
    (out / LOGS).mkdir(parents=True, exist_ok=True)
    try:
        while left or running:
            for ended in [one for one in running if one.process.poll() is not None]:
                running.remove(ended)
                ended.log.close()
                name, code = ended.queued.name, ended.process.returncode
                if code and failures.setdefault(name, 0) < TRIES - 1:
                    left.insert(0, ended.queued)
                failures |= {name: failures.get(name, 0) + 1} if code else {}
                yield f"{name} ended with {code} on {ended.card}"
            while start := _next(left, running, cards):
                queued, card = start
                left.remove(queued)
                running.append(_start(queued, card, cards[card], out, program))
                yield f"{queued.name} starts on {card}"
            time.sleep(seconds)
    finally:
        for one in running:
            one.process.terminate()
    if bad := [name for name, times in failures.items() if times == TRIES]:
        raise ValueError(f"rows failed {TRIES} times: {', '.join(bad)}; see {out / LOGS}")


def _next(
    left: Sequence[Queued], running: Sequence[_Running], cards: Mapping[str, float]
) -> tuple[Queued, str] | None:
    """Return the next row and its card, or None if there is no room or none is ready."""
    room = {
        card: size - sum(one.queued.gigabytes + BESIDE for one in running if one.card == card)
        for card, size in cards.items()
    }
    card = max(room, key=lambda name: room[name])
    unfinished = [*left, *(one.queued for one in running)]
    for queued in left:
        ready = not any(queued.needs(other) for other in unfinished if other is not queued)
        if ready and queued.gigabytes + BESIDE <= room[card]:
            return queued, card
    return None


def _start(queued: Queued, card: str, size: float, out: Path, program: Sequence[str]) -> _Running:
    """Start a row on a card."""
    share = f"{queued.gigabytes / size:.3f}"
    own = {"CUDA_VISIBLE_DEVICES": card, "XLA_PYTHON_CLIENT_MEM_FRACTION": share}
    log = (out / LOGS / f"{queued.name}.log").open("ab")
    command = [*program, *queued.words, "--out", str(out)]
    process = subprocess.Popen(command, env={**os.environ, **own}, stdout=log, stderr=log)
    return _Running(queued, card, process, log)


def cards_here() -> dict[str, float]:
    """Return the GB of each GPU of this host, from NVIDIA's driver.

    Raises:
        ValueError: There is no driver.
    """
    asked = ["nvidia-smi", "--query-gpu=index,memory.total", "--format=csv,noheader,nounits"]
    try:
        output = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        raise ValueError(f"no NVIDIA GPU was found ({error}); make rows one by one: row") from None
    lines = [line.split(",") for line in output.splitlines()]
    return {index.strip(): int(mebibytes) * 2**20 / 1e9 for index, mebibytes in lines}
