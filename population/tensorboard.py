"""TensorBoard event files of a run.

For each member a folder of scalars over its environment steps.
"""

import struct
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import polars as pl

from population.config import TrainConfig
from population.train import Progress

SECONDS_BETWEEN_FLUSHES = 5.0
_PATTERN = "events.out.tfevents.*"
_NOT_SCALARS = ("update", "steps", "seconds", "member", "disability", "seed")
_EPISODE = ("return", "reward", "episodes", "nonfinite")


class EventFiles:
    """Writes what a run reports.

    An update of a member is one event, which a file holds whole or not at all. A run that goes on
    begins after the last step that the files hold, with what its own metrics have kept: no step is
    written twice, and none is left out.

    Args:
        config: The run.
        run: Its folder.
        folder: Where the members' folders are; other runs may write theirs beside them.

    Raises:
        ValueError: tensorboardX is not installed, or the run is new and there are event files of
            its members.
    """

    def __init__(self, config: TrainConfig, run: Path, folder: Path) -> None:
        self._summary, self._event, self._writer = _library()
        self._folders = [folder / name.replace("/", "-") for name in config.names]
        self._metrics, self._files, self._caught_up = run / "metrics.parquet", {}, False
        if len(set(self._folders)) < len(self._folders):
            raise ValueError(
                "members of one disability setting and seed would share event files; train them "
                "apart"
            )
        self._written = [_last_step(path, self._event) for path in self._folders]
        if any(step >= 0 for step in self._written) and not (run / "config.json").exists():
            raise ValueError(
                f"{folder} holds event files of another run of {self._folders[0].name}; choose "
                "another --tensorboard"
            )
        self._flushed = time.monotonic()

    def __call__(self, progress: Progress) -> None:
        """Write the newest updates, after those that an earlier process left out."""
        self.catch_up(progress.rows["update"][0])
        self._write(
            progress.rows,
            {"speed/steps_per_second": progress.steps_per_second / len(self._folders)},
        )
        if time.monotonic() - self._flushed > SECONDS_BETWEEN_FLUSHES:
            self._flush()

    def catch_up(self, before: int | None = None) -> None:
        """Write what the run's metrics have and the files lack, once.

        Only of updates `before` one if it is given.
        """
        if not self._caught_up and self._metrics.exists():
            rows = pl.read_parquet(self._metrics)
            self._write(rows if before is None else rows.filter(pl.col("update") < before), {})
        self._caught_up = True

    def close(self) -> None:
        """Write what is still in memory, and close the files."""
        self._flush()
        for file in self._files.values():
            file.close()

    def _write(self, rows: pl.DataFrame, more: dict[str, float]) -> None:
        for row in rows.iter_rows(named=True):
            member, step = row["member"], row["steps"]
            if step <= self._written[member]:
                continue
            values = [
                self._summary.Value(tag=name, simple_value=value)
                for name, value in (scalars(row) | more).items()
            ]
            event = self._event(
                step=step, wall_time=time.time(), summary=self._summary(value=values)
            )
            self._file(member).write_event(event)
            self._written[member] = step

    def _file(self, member: int) -> Any:
        if member not in self._files:
            folder = self._folders[member]
            folder.mkdir(parents=True, exist_ok=True)
            # A process that begins in the same second as another did has a name of its own.
            self._files[member] = self._writer(
                str(folder / "events"), f".{self._written[member] + 1}"
            )
        return self._files[member]

    def _flush(self) -> None:
        for file in self._files.values():
            file.flush()
        self._flushed = time.monotonic()


def scalars(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a row of metrics holds, by the names under which it is shown."""
    shown = {name: value for name, value in row.items() if name not in _NOT_SCALARS}
    return {tag(name): value for name, value in shown.items() if value is not None}


def tag(metric: str) -> str:
    """Return the name under which TensorBoard shows a metric: its first part is the group."""
    if metric in _EPISODE:
        return f"episode/{metric}"
    if metric.startswith("term_"):
        return f"terms/{metric.removeprefix('term_')}"
    return f"learning/{metric}"


def _library() -> tuple[Any, Any, Any]:
    """Return the classes of summaries, of events and of their writer."""
    try:
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto import event_pb2, summary_pb2
    except ImportError:
        raise ValueError(
            "TensorBoard event files need the package tensorboardX; install it with: "
            "pip install 'assistax-zoo[tensorboard]'"
        ) from None
    messages: Any = (
        summary_pb2,
        event_pb2,
    )  # made at import time: type checkers cannot see what is in them
    return messages[0].Summary, messages[1].Event, EventsWriter


def _last_step(folder: Path, event: Any) -> int:
    """Return the last step that a member's files hold; -1 without any."""
    steps = [
        event.FromString(record).step
        for path in _files(folder)
        for record in _records(path.read_bytes())
    ]
    return max(steps, default=-1)


def _files(folder: Path) -> Iterable[Path]:
    return sorted(folder.glob(_PATTERN))


def _records(data: bytes) -> Iterator[bytes]:
    """Yield the whole records of an event file, each between its length and its checksum."""
    start = 0
    while len(data) - start >= 12:
        (length,) = struct.unpack_from("<Q", data, start)
        if len(data) < (end := start + 12 + length) + 4:
            return
        yield data[start + 12 : end]
        start = end + 4
