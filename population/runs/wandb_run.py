"""Log of a run on Weights & Biases: one W&B run for each member, with TensorBoard's names."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.extras import optional
from population.config import TrainConfig
from population.runs.tensorboard import scalars
from population.runs.train import Progress

PREFIX = "wandb:"  # marks a project, in place of a folder for event files


class WandbRuns:
    """Log that sends a run's reports to Weights & Biases.

    W&B runs begin with the first report, after training has created its folder, in which W&B keeps
    its files. A resumed run continues the same W&B run with its next reports; its `metrics.parquet`
    has all updates.

    Args:
        config: The run.
        folder: The run's folder, whose path identifies the W&B runs.
        project: Project of W&B; `WANDB_MODE=offline` sends nothing.

    Raises:
        ValueError: wandb is not installed, or, with the first report, there is no login.
    """

    def __init__(self, config: TrainConfig, folder: Path, project: str) -> None:
        self._wandb = optional("wandb", "sending to Weights & Biases", "wandb")
        self._config, self._folder, self._project = config, folder, project
        self._runs: list[Any] = []

    def __call__(self, progress: Progress) -> None:
        """Send the metrics of the newest updates."""
        if not self._runs:
            self._begin()
        speed = {"speed/steps_per_second": progress.steps_per_second / len(self._runs)}
        rows: pl.DataFrame = progress.rows
        for row in rows.iter_rows(named=True):
            self._runs[row["member"]].log(scalars(row) | speed, step=row["steps"])

    def catch_up(self) -> None:
        """Do nothing, since all reports are sent already."""

    def close(self) -> None:
        """Send pending reports and finish the W&B runs."""
        for run in self._runs:
            run.finish()

    def _begin(self) -> None:
        """Start or continue a W&B run for each member."""
        place, trainer = str(self._folder.resolve()), dataclasses.asdict(self._config.trainer)
        for name in (name.replace("/", "-") for name in self._config.names):
            try:
                run = self._wandb.init(
                    project=self._project,
                    name=name,
                    group=self._folder.name,
                    id=hashlib.sha256(f"{place} {name}".encode()).hexdigest()[:16],
                    resume="allow",
                    reinit="create_new",
                    dir=place,
                    settings=self._wandb.Settings(console="off"),  # several share one
                    config={"task": self._config.task, **trainer},
                )
            except self._wandb.errors.Error as error:
                raise ValueError(
                    f"Weights & Biases took no run: {' '.join(str(error).split())}; log in with "
                    "`wandb login`, or keep the run in its folder with WANDB_MODE=offline"
                ) from None
            self._runs.append(run)
