"""TensorBoard event files of a run.

For each member a folder of scalars over its environment steps.
"""

import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.extras import optional
from assistax_base.parquet import read_parquet
from population.config import TrainConfig
from population.runs.folder import OF_EPISODES
from population.runs.train import Progress

SECONDS_BETWEEN_FLUSHES = 5.0
_NOT_SCALARS = ("update", "steps", "seconds", "member", "disability", "seed")
_EPISODE = (*OF_EPISODES, "reward", "episodes", "nonfinite")


class EventFiles:
    """Writes a run's metrics.

    An update of a member is one event, which a file holds whole or not at all. A run that goes on
    begins new files with what its own metrics have kept, and a mark: TensorBoard then drops what
    the files of before say, so that it shows every step once.

    Args:
        config: The run.
        run: Its folder.
        folder: Where the members' folders are; other runs may write theirs beside them.

    Raises:
        ValueError: tensorboardX is not installed, or the run is new and there are event files of
            its members.
    """

    def __init__(self, config: TrainConfig, run: Path, folder: Path) -> None:
        library = partial(optional, purpose="a log for TensorBoard", extra="tensorboard")
        self._writer = library("tensorboardX.event_file_writer").EventsWriter
        self._event = library("tensorboardX.proto.event_pb2").Event
        self._summary = library("tensorboardX.proto.summary_pb2").Summary
        self._folders = [folder / name.replace("/", "-") for name in config.names]
        self._metrics, self._files = run / "metrics.parquet", []
        if len(set(self._folders)) < len(self._folders):
            raise ValueError(
                "members with the same disability setting and seed would share event files; train "
                "them in separate runs"
            )
        there = any(any(path.glob("events.out.tfevents.*")) for path in self._folders)
        if there and not (run / "config.json").exists():
            raise ValueError(
                f"{folder} holds event files of another run of {self._folders[0].name}; choose "
                "another folder"
            )
        self._flushed = time.monotonic()

    def __call__(self, progress: Progress) -> None:
        """Write the newest updates, after those of earlier processes."""
        self.catch_up(progress.rows["update"][0])
        speed = progress.steps_per_second / len(self._folders)
        self._write(progress.rows, {"speed/steps_per_second": speed})
        if time.monotonic() - self._flushed > SECONDS_BETWEEN_FLUSHES:
            self._flush()

    def catch_up(self, before: int | None = None) -> None:
        """Open the files once, and write the run's earlier metrics.

        Only of updates `before` one if it is given.
        """
        if self._files:
            return
        self._files = [self._begin(folder) for folder in self._folders]
        if self._metrics.exists():
            rows = read_parquet(self._metrics)
            self._write(rows if before is None else rows.filter(pl.col("update") < before), {})

    def close(self) -> None:
        """Write the buffered events, and close the files."""
        for file in self._files:
            file.close()

    def _begin(self, folder: Path) -> Any:
        folder.mkdir(parents=True, exist_ok=True)
        file = self._writer(str(folder / "events"))
        file.write_event(self._event(step=0, session_log={"status": "START"}))
        return file

    def _write(self, rows: pl.DataFrame, more: dict[str, float]) -> None:
        for row in rows.iter_rows(named=True):
            values = [
                self._summary.Value(tag=name, simple_value=value)
                for name, value in (scalars(row) | more).items()
            ]
            event = self._event(
                step=row["steps"], wall_time=time.time(), summary=self._summary(value=values)
            )
            self._files[row["member"]].write_event(event)

    def _flush(self) -> None:
        for file in self._files:
            file.flush()
        self._flushed = time.monotonic()


def scalars(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the scalars of a row of metrics by their tags."""
    shown = {name: value for name, value in row.items() if name not in _NOT_SCALARS}
    return {tag(name): value for name, value in shown.items() if value is not None}


def tag(metric: str) -> str:
    """Return the name under which TensorBoard shows a metric: its first part is the group."""
    if metric in _EPISODE:
        return f"episode/{metric}"
    if metric.startswith("term_"):
        return f"terms/{metric.removeprefix('term_')}"
    return f"learning/{metric}"
