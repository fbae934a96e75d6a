"""Progress of a run, and the clock that measures its speed."""

import dataclasses
import time

import polars as pl

from population.config import TrainConfig


@dataclasses.dataclass(frozen=True)
class Progress:
    """Progress of a run."""

    update: int  # updates done
    updates: int  # updates in all
    steps: int  # environment steps done, of all members together
    total_steps: int  # environment steps in all
    steps_per_second: float  # of this process; only its first report counts compilation too
    seconds_left: float | None  # at that speed; None in the first report, where it misleads
    rows: pl.DataFrame  # metrics of the newest updates: one row for each update and member


class Clock:
    """Training time over all processes of a run, and the speed since the first dispatch here."""

    def __init__(self, before: float, done: int) -> None:
        self._before, self._start = before, time.perf_counter()
        self._first: tuple[float, int] | None = None
        self._done = done

    def seconds(self) -> float:
        """Return the seconds of training so far."""
        return self._before + time.perf_counter() - self._start

    def progress(self, config: TrainConfig, done: int, rows: pl.DataFrame) -> Progress:
        """Return the progress after `done` updates, of which the newest have these metrics."""
        now = time.perf_counter()
        first, (since, start) = self._first is None, self._first or (self._start, self._done)
        self._first = self._first or (now, done)
        batch = config.trainer.batch_steps * len(config.members)
        speed = (done - start) * batch / (now - since)
        total = config.updates * batch
        left = None if first and done < config.updates else (total - done * batch) / speed
        return Progress(done, config.updates, done * batch, total, speed, left, rows)
