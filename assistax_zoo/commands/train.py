"""The command that trains teams."""

import contextlib
import json as jsonlib
import math
import os
import sys
import time
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from assistax_zoo.commands.options import Training
from assistax_zoo.console import SECONDS_BETWEEN_LINES, print_json, stdout_is_data

if TYPE_CHECKING:
    from population.train import Progress
    from population.trained_run import TrainedRun


def train(
    *,
    task: str,
    out: Path,
    algorithm: str | None = None,
    preset: Path | None = None,
    disability: str = "d1",
    steps: str = "10M",
    self_play_episodes: int = 16,
    training: Training = Training(),
    json: bool = False,
    json_lines: bool = False,
) -> None:
    """Train teams of a robot and a human, every seed with every disability setting, in one program.

    The same command again goes on where a run was interrupted, and ends with the same parameters.

    Args:
        task: Task, such as scratch.
        out: Folder of the run: checkpoints, metrics.parquet, and at the end the teams for
            `assistax-zoo publish`.
        algorithm: Preset of hyperparameters: ippo (default), mappo, isac or masac.
        preset: JSON file of hyperparameters in place of a built-in preset, as `assistax-zoo sweep`
            writes it.
        disability: Settings of the human, comma-separated, such as d1,d3.
        steps: Environment steps of each team, such as 500k, 10M or 2e7; rounded up to whole
            updates.
        self_play_episodes: Episodes of each team's final evaluation; 0 leaves it out.
        training: How it trains.
        json: Print the teams as JSON at the end.
        json_lines: Print a JSON object for each report on standard output instead of the live line.

    Example:
        assistax-zoo train --task scratch --disability d1,d3 --seeds 8 --steps 10M --out
        runs/scratch-ippo
    """
    from population.team_training import read_preset, train_teams

    changes: dict[str, Any] = {}
    if preset is not None:
        algorithm, changes = read_preset(preset, algorithm)
    algorithm = algorithm or "ippo"
    what = training.what(steps, changes)
    with shown_training(f"{task} {algorithm}", json_lines) as progress:
        run = train_teams(
            task,
            algorithm,
            folder=out,
            disabilities=disability.split(","),
            self_play_episodes=self_play_episodes,
            progress=progress,
            **what,
            **training.how(),
        )
    _report(run, json, json_lines)


@contextlib.contextmanager
def shown_training(name: str, json_lines: bool) -> "Generator[LiveLine | JsonLines]":
    """Show a training's reports on standard error, or as JSON lines on standard output.

    What libraries print meanwhile goes to standard error.
    """
    sys.stdout.flush()
    with os.fdopen(os.dup(1), "w") as stdout, stdout_is_data():
        shown = JsonLines(stdout) if json_lines else LiveLine(name, sys.stderr)
        try:
            yield shown
        finally:
            shown.close()


class LiveLine:
    """Shows a run on one line of a terminal, or on a line every ten seconds elsewhere."""

    def __init__(self, name: str, stream: TextIO) -> None:
        self._name, self._stream = name, stream
        self._live, self._open, self._shown = stream.isatty(), False, -math.inf
        self._return: str | None = None

    def __call__(self, progress: "Progress") -> None:
        mean = progress.rows["return"].mean()
        if mean is not None:
            self._return = f"return {mean:.1f}"
        earned = (
            self._return
            or f"reward {progress.rows['reward'].mean():.2f} a step, no whole episode yet"
        )
        now, last = time.monotonic(), progress.update == progress.updates
        if not (self._live or last or now - self._shown >= SECONDS_BETWEEN_LINES):
            return
        self._shown = now
        line = (
            f"{self._name}: {_count(progress.steps)} of {_count(progress.total_steps)} steps, "
            f"{progress.steps_per_second:,.0f} steps/s, {earned}, "
            f"{_duration(progress.seconds_left)} left"
        )
        print(
            f"\r\x1b[2K{line}" if self._live else line,
            end="" if self._live else "\n",
            file=self._stream,
            flush=True,
        )
        self._open = self._live

    def close(self) -> None:
        """End the line, so that what follows starts on its own."""
        if self._open:
            print(file=self._stream, flush=True)


class JsonLines:
    """Prints each report of a run as one line of JSON."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __call__(self, progress: "Progress") -> None:
        newest = progress.rows.filter(progress.rows["update"] == progress.update)
        report = {
            "update": progress.update,
            "updates": progress.updates,
            "steps": progress.steps,
            "total_steps": progress.total_steps,
            "steps_per_second": round(progress.steps_per_second, 1),
            "seconds_left": round(progress.seconds_left, 1),
            "return": newest["return"].mean(),
            "nonfinite": int(newest["nonfinite"].sum()),
            "members": newest.select("disability", "seed", "return", "reward").to_dicts(),
        }
        print(jsonlib.dumps(report), file=self._stream, flush=True)

    def close(self) -> None:
        """Nothing to end: every report is a whole line."""


def _report(run: "TrainedRun", json: bool, json_lines: bool) -> None:
    """Print the finished teams."""
    task, algorithm = run.config.task, run.config.algorithm
    rows = [
        {
            "task": task,
            "algorithm": algorithm,
            "disability": member.disability,
            "seed": member.seed,
            "self_play": figures,
        }
        for member, figures in zip(run.config.members, run.self_play, strict=True)
    ]
    if json_lines:
        print(jsonlib.dumps({"run": str(run.folder), "teams": rows}), flush=True)
    elif json:
        print_json({"run": run.folder, "training": run.training, "teams": rows})
    else:
        for name, figures in zip(run.names, run.self_play, strict=True):
            print(f"{name}  {_measured(figures)}")
        publish = f"assistax-zoo publish {run.folder} --release v0 --registry my-zoo/registry.json"
        print(f"{len(rows)} teams in {run.folder}; next: {publish}")


def _measured(figures: Mapping[str, Any] | None) -> str:
    if figures is None:
        return "not evaluated"
    low, high = figures["mean_ci"]
    return f"self-play return {figures['mean']:.1f} ({low:.1f} to {high:.1f})"


def _count(steps: int) -> str:
    for size, unit in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if steps >= size:
            return f"{steps / size:.2f}{unit}"
    return str(steps)


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"{hours} h {minutes} min"
        if hours
        else f"{minutes} min"
        if minutes >= 2
        else f"{60 * minutes + seconds} s"
    )
