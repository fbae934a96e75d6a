"""The command that trains robots with frozen partners of the zoo, for zero-shot coordination."""

import dataclasses
import json as jsonlib
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from assistax_base.errors import counted
from assistax_zoo.commands.options import Choosing, Training, parse_names
from assistax_zoo.commands.training.train import shown_training
from assistax_zoo.shell.console import StudyLine, answer, command_line
from zoo.registry import Registry, load_registry
from zoo.schema import RULES

if TYPE_CHECKING:
    from evaluation.ego_training import EgoTraining, TrainedEgos
    from evaluation.validation import Choices


def train_ego(
    *,
    task: str,
    out: Path,
    split: str | None = None,
    partners: Literal["persons", "mixed"] | None = None,
    algorithm: str = "ppo",
    steps: str = "20M",
    preferences: str | None = None,
    choosing: Choosing = Choosing(),
    told: bool = False,
    teacher: tuple[Path, ...] = (),
    training: Training = Training(),
    registry: Path | None = None,
    json: bool = False,
    json_lines: bool = False,
) -> None:
    """Train robots with the partners of a split's training side, which stay as they are.

    Every partner gets the same share of the simulations, and acts with its most likely action. The
    test side is never loaded. Each seed's robot is a policy file.

    Args:
        task: Task, such as scratch.
        out: Folder of the run; its folder policies holds a .safetensors file for each seed.
        split: Split of the partners, an id or its beginning; default that of the release.
        partners: persons for a new one each episode; mixed for teams in half of the simulations.
        algorithm: ppo, sac, dagger, or a method, such as asymmetric_gru; docs/methods.md has all.
        steps: Environment steps of each robot, such as 500k or 20M, rounded up to whole updates.
        preferences: Of a gentle task's humans, such as p2,p3; default the split's, or all.
        told: Let robots observe the human's preference: a row to compare with.
        teacher: Policy file of a told robot, which dagger imitates; repeat it for more.
        choosing: What is chosen among.
        training: How it trains.
        registry: Registry to read instead of the installed one.
        json: Print the policy files as JSON at the end.
        json_lines: Print a JSON object for each report on standard output instead of the live line.

    Example:
        assistax-zoo train-ego --task scratch --split half --seeds 16 --steps 20M --out runs/ego
    """
    what = training.what(steps)
    first = "stage 1 of 2, training of " if choosing.validate else ""
    with shown_training(f"{first}{task} {algorithm}", json_lines) as progress:
        from evaluation.ego_training import prepare, with_teachers

        loaded = load_registry(registry)
        prepared = prepare(
            loaded,
            task,
            split=split,
            partners=partners,
            algorithm=algorithm,
            preferences=parse_names(preferences),
            told=told,
            **what,
        )
        prepared = with_teachers(prepared, teacher)
        egos = _trained(loaded, prepared, out, choosing, progress=progress, **training.how())
    _report(egos, _choices(loaded, prepared, egos, choosing, training.backend), json, json_lines)


def _trained(
    registry: Registry, prepared: "EgoTraining", out: Path, choosing: Choosing, **options: Any
) -> "TrainedEgos":
    """Train, and record by which command."""
    from evaluation.ego_training import train_egos
    from evaluation.record.manifest import record_command
    from evaluation.validation import validation_side
    from population.runs.folder import RunFolder

    if choosing.validate:
        validation_side(registry, prepared.split)
    print(prepared.summary, file=sys.stderr)
    finished = RunFolder(out).finished(prepared.config)
    egos = train_egos(prepared, out, snapshots=choosing.validate, **options)
    record_command(out, command_line(), filled=not finished)
    return egos


def _choices(
    registry: Registry,
    prepared: "EgoTraining",
    egos: "TrainedEgos",
    choosing: Choosing,
    backend: str,
) -> "Choices | None":
    """Return the choices made with the validation side; None if it was not asked for."""
    if not choosing.validate:
        return None
    from evaluation.play.how import PlaySettings
    from evaluation.validation import choose

    task = prepared.config.task
    with StudyLine(f"stage 2 of 2, validation of {task}") as line:
        where = registry, prepared, egos.run, PlaySettings(task, backend=backend)
        return choose(*where, best_of=choosing.best_of, on_progress=line)


def _report(egos: "TrainedEgos", choices: "Choices | None", json: bool, json_lines: bool) -> None:
    """Print the policy files, and which of them were chosen."""
    from evaluation.validation import CHOSEN
    from zoo.partners.kinds import kind_of

    run = egos.run
    result: dict[str, Any] = {
        "run": str(run.folder),
        "split": egos.split.id,
        "partners": len(egos.split.train),
        "policies": [str(path) for path in egos.files],
    }
    result |= {"choices": dataclasses.asdict(choices)} if choices else {}
    files = egos.files[0] if len(egos.files) == 1 else egos.files[0].parent / "*.safetensors"
    whom = " --split both"
    if egos.split.rule not in RULES:  # the word of another kind than teams
        alone = kind_of(egos.split.train).word == egos.split.rule
        whom = f" --partners {egos.split.rule}" if alone else ""
    chosen = [
        f"seed {choice.seed}: {choice.steps:,} steps, {choice.mean:.1f} on the validation side"
        for choice in (choices.by_seed if choices else ())
    ]
    if choices:
        files = run.folder / CHOSEN / "*.safetensors"
    lines = [
        *chosen,
        f"{counted(len(egos.files), 'robot')} in {Path(files).parent}; next:",
        f"assistax-zoo evaluate --task {run.config.task}{whom} {shlex.quote(str(files))}",
    ]
    answer(json, result, *([jsonlib.dumps(result)] if json_lines else lines))
