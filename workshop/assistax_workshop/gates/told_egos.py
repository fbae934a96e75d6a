"""Trains robots that are told what their partners like, and evaluates them beside other methods.

Such robots observe more than any robot may: they say what adaptation could earn at best, and
nothing else wants them, hence no command publishes or plays them.
"""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from assistax_envs import make
from assistax_workshop.gates.audit import BOTH
from assistax_workshop.gates.audit_teams import read_robots
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
from zoo.registry import Registry


def train_told_egos(
    registry: Registry,
    task: str,
    folder: Path,
    command: str,
    *,
    split: str | None = None,
    seeds: Sequence[int],
    steps: int,
    episodes: int = 8,
    changes: Mapping[str, Any] | None = None,
    backend: str = "auto",
) -> EvaluationSummary:
    """Train told robots into FOLDER/training, and evaluate them into FOLDER/evaluation.

    What was interrupted goes on.

    Args:
        registry: Where partners come from.
        task: Gentle task.
        folder: Of the run and the evaluation.
        command: That is recorded with both.
        split: Split whose training side they learn with; default that of the release.
        seeds: One robot each.
        steps: Environment steps of each robot.
        episodes: Of each pair.
        changes: Of the preset's hyperparameters.
        backend: Physics.
    """
    env, run = make(task, backend, told=BOTH), folder / "training"
    learning = prepare(
        registry, task, split=split, seeds=seeds, steps=steps, hyperparameters=changes or {}
    )
    finished = RunFolder(run).finished(learning.config)
    with contextlib.closing(TrainingLine(str(folder))) as line:
        train(learning.config, env, run, partners=learning.partners, progress=line)
    write_egos(read_trained_run(run), learning)
    record_command(run, command, filled=not finished)
    summary = evaluate(registry, task, folder, learning.split.id, episodes, backend)
    simulated = summary.env_steps_per_second is not None
    write_run(folder / "evaluation", command, simulated)
    return summary


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
    usual, job = make_job(how, cast.robots, cast.humans, cast.sides, cast.version)
    if manifest.preferences:
        job = job.with_side_preferences(manifest.preferences)
    job = dataclasses.replace(job, engine={**job.engine, "condition": "told"})
    env = make(task, usual.backend, told=BOTH)
    result = run_job(env, job, folder / "evaluation")
    release = manifest.release
    context = context_of(job, result, split=manifest, release=release, lock=registry.lock)
    return save_evaluation(Record(result.table, folder / "evaluation"), context, met=cast.met)
