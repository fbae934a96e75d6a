"""The command that trains teams."""

import ast
import contextlib
import json as jsonlib
import math
import os
import re
import sys
import time
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

from cyclopts import Parameter

from assistax_zoo.console import SECONDS_BETWEEN_LINES, print_json, stdout_is_data

if TYPE_CHECKING:
    from population.train import Progress
    from population.trained_run import TrainedRun

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "b": 10**9}


def train(
    *,
    task: str,
    out: Path,
    algorithm: str | None = None,
    preset: Path | None = None,
    disability: str = "d1",
    seeds: str = "1",
    steps: str = "10M",
    backend: str = "auto",
    num_envs: int | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    self_play_episodes: int = 16,
    checkpoint_every: int | None = None,
    updates_per_call: int | None = None,
    resume: bool = True,
    tensorboard: Path | None = None,
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
        seeds: How many, numbered from 0, or which: 8, 0-7 or 2,5.
        steps: Environment steps of each team, such as 500k, 10M or 2e7; rounded up to whole
            updates.
        backend: Physics: native, mjx, mjx-warp, or auto for the fastest one here.
        num_envs: Simulations of each team; default the preset's.
        set_: Another hyperparameter, such as learning_rate=3e-4, torso=gru or shared=true; repeat
            it for more.
        self_play_episodes: Episodes of each team's final evaluation; 0 leaves it out.
        checkpoint_every: Updates between checkpoints; default 20 for PPO, 2000 for SAC, whose
            updates are short.
        updates_per_call: Updates dispatched to the device at once; default 1 for PPO, 20 for SAC.
        resume: Go on with a run that the folder holds.
        tensorboard: Folder for TensorBoard event files, which several runs may share; needs
            assistax-zoo[tensorboard].
        json: Print the teams as JSON at the end.
        json_lines: Print a JSON object for each report on standard output instead of the live line.

    Example:
        assistax-zoo train --task scratch --disability d1,d3 --seeds 8 --steps 10M --out
        runs/scratch-ippo
    """
    from population.team_training import check_names, read_preset, train_teams

    check_names(task)
    changes: dict[str, Any] = {}
    if preset is not None:
        algorithm, changes = read_preset(preset, algorithm)
    algorithm, settings = algorithm or "ippo", disability.split(",")
    changes |= parse_changes(set_) | ({} if num_envs is None else {"num_envs": num_envs})
    with shown_training(f"{task} {algorithm}", json_lines) as progress:
        run = train_teams(
            task,
            algorithm,
            folder=out,
            disabilities=settings,
            seeds=parse_seeds(seeds),
            steps=parse_steps(steps),
            hyperparameters=changes,
            backend=backend,
            self_play_episodes=self_play_episodes,
            checkpoint_every=checkpoint_every,
            updates_per_call=updates_per_call,
            resume=resume,
            tensorboard=tensorboard,
            progress=progress,
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


def parse_steps(text: str) -> int:
    """Return a number of steps written as 250000, 500k, 10M or 2e7."""
    match = re.fullmatch(
        r"([0-9]+(?:\.[0-9]*)?(?:[eE][0-9]{1,2})?)([kmgb]?)", text.strip(), re.IGNORECASE
    )
    steps = float(match[1]) * _UNITS[match[2].lower()] if match else 0.0
    if not 1.0 <= steps < 1e15:
        raise ValueError(f"steps is {text!r}; give a number above 0, such as 500k, 10M or 2e7")
    return math.ceil(steps)


def parse_seeds(text: str) -> list[int]:
    """Return the seeds of "8" (0 to 7), "0-7" or "2,5"."""
    ranges = [re.fullmatch(r"(\d+)(?:-(\d+))?", part.strip()) for part in text.split(",")]
    if text.strip().isdigit():
        seeds = list(range(int(text)))
    else:
        seeds = [seed for r in ranges if r for seed in range(int(r[1]), int(r[2] or r[1]) + 1)]
    if not seeds or not all(ranges) or len(set(seeds)) < len(seeds):
        raise ValueError(
            f"seeds is {text!r}; give how many, such as 8, or which, such as 0-7 or 2,5, each once"
        )
    return seeds


def parse_changes(words: Sequence[str]) -> dict[str, Any]:
    """Return the hyperparameters of words such as "learning_rate=3e-4"."""
    changes = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals or not name:
            raise ValueError(f"--set is {word!r}; give name=value, such as learning_rate=3e-4")
        try:
            changes[name.strip()] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            changes[name.strip()] = {"true": True, "false": False}.get(value.lower(), value)
    return changes


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
