"""The command that trains robots with frozen partners of the zoo, for zero-shot coordination."""

import json as jsonlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from assistax_zoo.commands.train import parse_changes, parse_seeds, parse_steps, shown_training
from assistax_zoo.console import print_json

if TYPE_CHECKING:
    from evaluation.ego_training import TrainedEgos


def train_ego(
    *,
    task: str,
    out: Path,
    split: str | None = None,
    algorithm: str = "ppo",
    seeds: str = "1",
    steps: str = "20M",
    backend: str = "auto",
    num_envs: int | None = None,
    set_: Annotated[tuple[str, ...], Parameter(name="--set", negative="")] = (),
    checkpoint_every: int | None = None,
    updates_per_call: int | None = None,
    resume: bool = True,
    tensorboard: Path | None = None,
    registry: Path | None = None,
    json: bool = False,
    json_lines: bool = False,
) -> None:
    """Train robots with the partners of a split's training half, which stay as they are.

    Every partner gets the same share of the simulations, under its own disability setting, and acts
    with its most likely action. The test half is never loaded. The robots are written as policy
    files, the seeds of one method.

    Args:
        task: Task, such as scratch.
        out: Folder of the run; its folder policies holds a .safetensors file for each seed.
        split: Split whose training half are the partners: an id or the beginning of one; default
            the release's own.
        algorithm: ppo or sac.
        seeds: How many, numbered from 0, or which: 16, 0-7 or 2,5.
        steps: Environment steps of each robot, such as 500k, 20M or 2e7; rounded up to whole
            updates.
        backend: Physics: native, mjx, mjx-warp, or auto for the fastest one here.
        num_envs: Simulations of each robot, a multiple of the number of partners; default the
            nearest to the preset's.
        set_: Another hyperparameter, such as learning_rate=3e-4 or torso=gru; repeat it for more.
        checkpoint_every: Updates between checkpoints; default 20 for PPO, 2000 for SAC, whose
            updates are short.
        updates_per_call: Updates dispatched to the device at once; default 1 for PPO, 20 for SAC.
        resume: Go on with a run that the folder holds.
        tensorboard: Folder for TensorBoard event files, which several runs may share; needs
            assistax-zoo[tensorboard].
        registry: Registry to read instead of the installed one.
        json: Print the policy files as JSON at the end.
        json_lines: Print a JSON object for each report on standard output instead of the live line.

    Example:
        assistax-zoo train-ego --task scratch --split half --algorithm ppo --seeds 16 --steps 20M
        --out runs/ego
    """
    from population.team_training import check_names

    check_names(task)
    changes = parse_changes(set_) | ({} if num_envs is None else {"num_envs": num_envs})
    numbers, total = parse_seeds(seeds), parse_steps(steps)
    with shown_training(f"{task} {algorithm}", json_lines) as progress:
        from evaluation.ego_training import prepare, train_egos
        from zoo.registry import load_registry

        training = prepare(
            load_registry(registry),
            task,
            split=split,
            algorithm=algorithm,
            seeds=numbers,
            steps=total,
            hyperparameters=changes,
            checkpoint_every=checkpoint_every,
            updates_per_call=updates_per_call,
        )
        print(training.summary, file=sys.stderr)
        egos = train_egos(
            training,
            out,
            backend=backend,
            resume=resume,
            tensorboard=tensorboard,
            progress=progress,
        )
    _report(egos, json, json_lines)


def _report(egos: "TrainedEgos", json: bool, json_lines: bool) -> None:
    """Print the policy files."""
    run = egos.run
    if json or json_lines:
        result = {
            "run": str(run.folder),
            "split": egos.split.id,
            "partners": len(run.config.partners),
            "policies": [str(path) for path in egos.files],
        }
        print_json(result) if json else print(jsonlib.dumps(result), flush=True)
        return
    words = " ".join(f"--policy {path}" for path in egos.files)
    print(f"{len(egos.files)} robots in {egos.files[0].parent}; next:")
    print(f"assistax-zoo evaluate --task {run.config.task} --split both {words}")
