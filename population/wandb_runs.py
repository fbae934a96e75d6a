"""Runs of Weights & Biases: one for each member, with the names that TensorBoard shows."""

import dataclasses
import hashlib
from pathlib import Path

import polars as pl

from population.config import TrainConfig
from population.extras import optional
from population.tensorboard import scalars
from population.train import Progress

PREFIX = "wandb:"  # before a project, where else a folder for event files is named


class WandbRuns:
    """Sends what a run reports.

    A run that goes on goes on there too, from what it reports next: its `metrics.parquet` has all.

    Args:
        config: The run.
        folder: Its folder, by whose path it is found again.
        project: Of W&B, to whose service `WANDB_MODE=offline` sends nothing.

    Raises:
        ValueError: wandb is not installed.
    """

    def __init__(self, config: TrainConfig, folder: Path, project: str) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        names = [name.replace("/", "-") for name in config.names]
        place = str(folder.resolve())
        init = optional("wandb", "sending to Weights & Biases", "wandb").init
        self._runs = [
            init(
                project=project,
                name=name,
                group=folder.name,
                id=hashlib.sha256(f"{place} {name}".encode()).hexdigest()[:16],
                resume="allow",
                reinit="create_new",
                dir=place,
                config={"task": config.task, **dataclasses.asdict(config.trainer)},
            )
            for name in names
        ]

    def __call__(self, progress: Progress) -> None:
        """Send the newest updates."""
        speed = {"speed/steps_per_second": progress.steps_per_second / len(self._runs)}
        rows: pl.DataFrame = progress.rows
        for row in rows.iter_rows(named=True):
            self._runs[row["member"]].log(scalars(row) | speed, step=row["steps"])

    def catch_up(self) -> None:
        """Nothing: what was reported was sent."""

    def close(self) -> None:
        """Send what is still on its way."""
        for run in self._runs:
            run.finish()
