"""Trains robots that are told what their partners like, and evaluates them beside other methods.

    python -m assistax_workshop.gates.told_egos gentle_scratch runs/told --seeds 16 --steps 10M
    python -m assistax_workshop.gates.told_egos gentle_scratch runs/told --seeds 16 --steps 10M
    --set torso=gru

RUNS/training is as of `assistax-zoo train-ego`, RUNS/evaluation as of `evaluate --split both`. Such
robots observe more than any robot may: they say what adaptation could earn at best, and nothing
else wants them, hence no command publishes or plays them.
"""

import contextlib
import dataclasses
import shlex
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from assistax_envs import make
from assistax_workshop.gates.audit import BOTH
from assistax_workshop.gates.audit_teams import read_robots
from assistax_zoo.commands.options import parse_changes, parse_seeds, parse_steps
from assistax_zoo.shell.console import TrainingLine
from evaluation.cast.cast import Cast, choose_partners
from evaluation.ego_training import prepare, write_egos
from evaluation.figures.saved_tables import save_evaluation
from evaluation.figures.summary import EvaluationSummary
from evaluation.play.evaluator import run_job
from evaluation.play.how import How
from evaluation.play.study import context_of, make_job
from evaluation.record.manifest import record_command, write_run
from evaluation.record.record import Record
from population.runs.folder import RunFolder
from population.runs.train import train
from population.runs.trained import read_trained_run
from zoo.registry import Registry, load_registry


def main(
    task: str,
    folder: Path,
    /,
    *,
    split: str | None = None,
    seeds: str = "4",
    steps: str = "10M",
    episodes: int = 8,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    backend: str = "auto",
    registry: Path | None = None,
) -> None:
    """Train and evaluate told robots; what was interrupted goes on.

    Args:
        task: Gentle task.
        folder: Of the run and the evaluation.
        split: With whose training half they learn; default the release's own.
        seeds: How many, or which.
        steps: Environment steps of each robot.
        episodes: Of each pair.
        set_: Hyperparameter, such as num_envs=512; repeat it for more.
        backend: Physics.
        registry: Registry to read instead of the installed one.
    """
    zoo, env = load_registry(registry), make(task, backend, told=BOTH)
    learning = prepare(
        zoo,
        task,
        split=split,
        seeds=parse_seeds(seeds),
        steps=parse_steps(steps),
        hyperparameters=parse_changes(set_),
    )
    run = folder / "training"
    finished = RunFolder(run).finished(learning.config)
    with contextlib.closing(TrainingLine(str(folder))) as line:
        train(learning.config, env, run, partners=learning.partners, progress=line)
    write_egos(read_trained_run(run), learning)
    command = shlex.join(["python", "-m", "assistax_workshop.gates.told_egos", *sys.argv[1:]])
    record_command(run, command, filled=not finished)
    summary = evaluate(zoo, task, folder, learning.split.id, episodes, backend)
    simulated = summary.env_steps_per_second is not None
    write_run(folder / "evaluation", command, simulated)
    for side, found in (("train", summary.m_train), ("test", summary.m_test)):
        print(f"{side}: {found.mean:.1f}" if found else f"{side}: nobody")


def evaluate(
    registry: Registry, task: str, folder: Path, split: str, episodes: int, backend: str
) -> EvaluationSummary:
    """Play the told robots of a folder with both sides of a split, and save what comes of it."""
    robots = read_robots([str(folder / "training")], registry, task).robots
    manifest, partners = choose_partners(registry, task, f"{split}:both", None)
    cast = Cast.of(
        registry,
        task=task,
        robots=robots,
        humans=partners,
        split=manifest,
        trained_with=split,
    )
    how = How(task, episodes, backend=backend)
    usual, job = make_job(how, cast.robots, cast.humans, cast.sides)
    if manifest.preferences:
        job = job.with_side_preferences(manifest.preferences)
    job = dataclasses.replace(job, engine={**job.engine, "condition": "told"})
    env = make(task, usual.backend, told=BOTH)
    result = run_job(env, job, folder / "evaluation")
    release = manifest.release
    context = context_of(job, result, split=manifest, release=release, lock=registry.lock)
    return save_evaluation(Record(result.table, folder / "evaluation"), context, met=cast.met)


if __name__ == "__main__":
    App(default_command=main)()
