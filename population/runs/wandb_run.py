"""Runs of Weights & Biases: one for each member, with the names that TensorBoard shows."""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.extras import optional
from population.config import TrainConfig
from population.runs.tensorboard import scalars
from population.runs.train import Progress

PREFIX = "wandb:"  # before a project, where else a folder for event files is named


class WandbRuns:
    """Sends what a run reports.

    Runs begin there with the first report, when training has taken its folder: W&B keeps its own
    files in it. A resumed run continues the same W&B run, with what it reports next;
    its `metrics.parquet` has everything.

    Args:
        config: The run.
        folder: Its folder, by whose path it is found again.
        project: Of W&B, to whose service `WANDB_MODE=offline` sends nothing.

    Raises:
        ValueError: wandb is not installed, or, with the first report, nobody is logged in.
    """

    def __init__(self, config: TrainConfig, folder: Path, project: str) -> None:
        self._wandb = optional("wandb", "sending to Weights & Biases", "wandb")
        self._config, self._folder, self._project = config, folder, project
        self._runs: list[Any] = []

    def __call__(self, progress: Progress) -> None:
        """Send the newest updates."""
        if not self._runs:
            self._begin()
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

    def _begin(self) -> None:
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
