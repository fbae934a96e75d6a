"""The command that trains robots with frozen partners of the zoo, for zero-shot coordination."""

import json as jsonlib
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from assistax_base.errors import counted
from assistax_zoo.commands.options import Training, parse_names
from assistax_zoo.commands.training.train import shown_training
from assistax_zoo.shell.console import answer, command_line
from zoo.ids import PERSONS
from zoo.registry import load_registry

if TYPE_CHECKING:
    from evaluation.ego_training import TrainedEgos


def train_ego(
    *,
    task: str,
    out: Path,
    split: str | None = None,
    partners: Literal["persons"] | None = None,
    algorithm: str = "ppo",
    steps: str = "20M",
    preferences: str | None = None,
    told: bool = False,
    training: Training = Training(),
    registry: Path | None = None,
    json: bool = False,
    json_lines: bool = False,
) -> None:
    """Train robots with the partners of a split's training half, which stay as they are.

    Every partner gets the same share of the simulations, and acts with its most likely action. The
    test half is never loaded. Each seed's robot is a policy file.

    Args:
        task: Task, such as scratch.
        out: Folder of the run; its folder policies holds a .safetensors file for each seed.
        split: Whose training half are the partners: an id or its beginning; default the release's.
        partners: persons for a new person of the training side each episode, in place of networks.
        algorithm: ppo, sac, or a method: gru, asymmetric, liam, palm, rma, gamma, rl2.
        steps: Environment steps of each robot, such as 500k or 20M, rounded up to whole updates.
        preferences: What the humans of a gentle task like, such as p2,p3, in turns; default those
            of the split's training half, or all, drawn anew each episode.
        told: Let robots observe what the human likes: a row to compare with.
        training: How it trains.
        registry: Registry to read instead of the installed one.
        json: Print the policy files as JSON at the end.
        json_lines: Print a JSON object for each report on standard output instead of the live line.

    Example:
        assistax-zoo train-ego --task scratch --split half --algorithm ppo --seeds 16 --steps 20M
        --out runs/ego
    """
    what = training.what(steps)
    with shown_training(f"{task} {algorithm}", json_lines) as progress:
        from evaluation.ego_training import prepare, train_egos
        from evaluation.record.manifest import record_command
        from population.runs.folder import RunFolder

        prepared = prepare(
            load_registry(registry),
            task,
            split=split,
            partners=partners,
            algorithm=algorithm,
            preferences=parse_names(preferences),
            told=told,
            **what,
        )
        print(prepared.summary, file=sys.stderr)
        finished = RunFolder(out).finished(prepared.config)
        egos = train_egos(prepared, out, progress=progress, **training.how())
    record_command(out, command_line(), filled=not finished)
    _report(egos, json, json_lines)


def _report(egos: "TrainedEgos", json: bool, json_lines: bool) -> None:
    """Print the policy files."""
    run = egos.run
    result = {
        "run": str(run.folder),
        "split": egos.split.id,
        "partners": len(egos.split.train),
        "policies": [str(path) for path in egos.files],
    }
    files = egos.files[0] if len(egos.files) == 1 else egos.files[0].parent / "*.safetensors"
    whom = "--split both"
    if egos.split.rule == PERSONS:
        whom = "--partners persons"
    lines = [
        f"{counted(len(egos.files), 'robot')} in {egos.files[0].parent}; next:",
        f"assistax-zoo evaluate --task {run.config.task} {whom} --policy {shlex.quote(str(files))}",
    ]
    answer(json, result, *([jsonlib.dumps(result)] if json_lines else lines))
