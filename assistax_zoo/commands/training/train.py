"""The command that trains teams."""

import contextlib
import functools
import json as jsonlib
import os
import sys
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from assistax_base.errors import counted
from assistax_zoo.commands.options import Training
from assistax_zoo.shell.console import TrainingLine, answer, stdout_is_data

if TYPE_CHECKING:
    from population.runs.train import Progress
    from population.runs.trained import TrainedRun


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

    The same command again continues an interrupted run, and ends with the same parameters.

    Args:
        task: Task, such as scratch.
        out: Folder of the run: checkpoints, metrics.parquet, and at the end the teams for
            `assistax-zoo publish`.
        algorithm: Preset of hyperparameters: ippo (default), mappo, isac, masac or mep.
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
    from assistax_zoo.training import train as train_teams
    from population.runs.logged_run import read_preset

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
def shown_training(name: str, json_lines: bool) -> Generator[Callable[["Progress"], None]]:
    """Show a training's reports on standard error, or as JSON lines on standard output.

    What libraries print meanwhile goes to standard error.
    """
    sys.stdout.flush()
    with (
        os.fdopen(os.dup(1), "w") as stdout,
        stdout_is_data(),
        TrainingLine(name) as line,
    ):
        yield functools.partial(_print_json_line, stdout) if json_lines else line


def _print_json_line(stream: TextIO, progress: "Progress") -> None:
    """Print one report of a run."""
    newest = progress.rows.filter(progress.rows["update"] == progress.update)
    report = {
        "update": progress.update,
        "updates": progress.updates,
        "steps": progress.steps,
        "total_steps": progress.total_steps,
        "steps_per_second": round(progress.steps_per_second, 1),
        "seconds_left": progress.seconds_left and round(progress.seconds_left, 1),
        "return": newest["return"].mean(),
        "nonfinite": int(newest["nonfinite"].sum()),
        "members": newest.select("disability", "seed", "return", "reward").to_dicts(),
    }
    print(jsonlib.dumps(report), file=stream, flush=True)


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
    line = [jsonlib.dumps({"run": str(run.folder), "teams": rows})]
    figures = zip(run.names, run.self_play, strict=True)
    measured = [f"{name}  {_measured(result)}" for name, result in figures]
    publish = f"assistax-zoo publish {run.folder} --release v0 --registry my-zoo/registry.json"
    lines = [*measured, f"{counted(len(rows), 'team')} in {run.folder}; next: {publish}"]
    content = {"run": run.folder, "training": run.training, "teams": rows}
    answer(json and not json_lines, content, *(line if json_lines else lines))


def _measured(figures: Mapping[str, Any] | None) -> str:
    if figures is None:
        return "not evaluated"
    low, high = figures["mean_ci"]
    return f"self-play return {figures['mean']:.1f} ({low:.1f} to {high:.1f})"
