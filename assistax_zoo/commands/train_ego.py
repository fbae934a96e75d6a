"""The command that trains robots with frozen partners of the zoo, for zero-shot coordination."""

import dataclasses
import json as jsonlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from assistax_zoo.commands.train import (
    check_names,
    parse_changes,
    parse_seeds,
    parse_steps,
    run_training,
)
from assistax_zoo.console import print_json

if TYPE_CHECKING:
    from population.config import TrainerConfig
    from population.partners import Partners
    from zoo.registry import Registry
    from zoo.schema import Split

ALGORITHMS = {"ppo": "ippo", "sac": "isac"}  # a single robot's algorithm, and the preset it takes
POLICIES = "policies"  # folder of the trained robots within a run


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
    from population.config import MIXED, Member, TrainConfig, preset
    from zoo.registry import load_registry

    check_names(task, ())
    if algorithm not in ALGORITHMS:
        raise ValueError(f"algorithm is {algorithm!r}; allowed are {', '.join(ALGORITHMS)}")
    numbers, total, changes = parse_seeds(seeds), parse_steps(steps), parse_changes(set_)
    changes |= {} if num_envs is None else {"num_envs": num_envs}
    trainer = preset(ALGORITHMS[algorithm], **changes)
    opened = load_registry(registry)
    chosen = opened.split(task, split)
    trainer = shared_out(trainer, len(chosen.train), chosen.id, keep="num_envs" in changes)
    partners = load_partners(opened, chosen)
    config = TrainConfig(
        task=task,
        algorithm=algorithm,
        members=tuple(Member(seed, MIXED) for seed in numbers),
        steps=total,
        trainer=trainer,
        checkpoint_every=trainer.checkpoint_every if checkpoint_every is None else checkpoint_every,
        updates_per_call=trainer.updates_per_call if updates_per_call is None else updates_per_call,
        self_play_episodes=0,
        partners=partners.names,
    )
    run_training(config, backend, out, resume, json_lines, partners, tensorboard)
    files = _write_policies(out, chosen)
    if json or json_lines:
        result = {
            "run": str(out),
            "split": chosen.id,
            "partners": len(partners),
            "policies": [str(p) for p in files],
        }
        print_json(result) if json else print(jsonlib.dumps(result), flush=True)
        return
    words = " ".join(f"--policy {path}" for path in files)
    print(f"{len(files)} robots in {out / POLICIES}; next:")
    print(f"assistax-zoo evaluate --task {task} --split both {words}")


def shared_out(trainer: "TrainerConfig", partners: int, split: str, keep: bool) -> "TrainerConfig":
    """Return hyperparameters with simulations that every partner gets the same share of, and say how many these are.

    Raises:
        ValueError: The number of simulations was asked for, to be kept, and has no such share.
    """
    from population.partners import fitting_envs

    fitting = fitting_envs(trainer.num_envs, partners, getattr(trainer, "minibatches", 1))
    if keep and trainer.num_envs % partners:
        raise ValueError(
            f"num_envs is {trainer.num_envs} with {partners} partners; every partner gets the same "
            f"share, so choose {fitting}, or leave --num-envs out"
        )
    chosen = trainer.num_envs if keep else fitting
    share = chosen // partners
    near = (
        ""
        if chosen == trainer.num_envs
        else f", {chosen} in place of the preset's {trainer.num_envs}"
    )
    print(
        f"{partners} partners of {split}, {share} simulation{'s' * (share > 1)} each{near}",
        file=sys.stderr,
    )
    return dataclasses.replace(trainer, num_envs=chosen)


def load_partners(registry: "Registry", split: "Split") -> "Partners":
    """Return the humans of a split's training half; no row of the test half is taken from any shard."""
    from population.partners import PartnerGroup, Partners
    from zoo.storage import load_stacks

    entries = [registry.policy(f"{team}/human") for team in split.train]
    settings = {entry.id: entry.partner_setting for entry in entries}
    return Partners(
        [
            PartnerGroup(
                group.spec, group.ids, tuple(settings[name] for name in group.ids), group.params
            )
            for group in load_stacks(registry, entries)
        ]
    )


def _write_policies(out: Path, split: "Split") -> list[Path]:
    """Write a policy file for each robot of a finished run."""
    from population.files import atomic_write
    from zoo.runs import read_run
    from zoo.storage import write_policy_file

    folder = out / POLICIES
    folder.mkdir(exist_ok=True)
    atomic_write(out / "split.json", split.model_dump_json().encode())
    files = []
    for ego in read_run(out):
        [(role, spec)] = ego.specs.items()
        metadata: dict[str, Any] = {
            "task": ego.task,
            "algorithm": ego.algorithm,
            "seed": ego.seed,
            "split": split.id,
            "training": dict(ego.training),
        }
        files.append(folder / f"{ego.algorithm}-s{ego.seed}.safetensors")
        write_policy_file(files[-1], spec, ego.params[role], metadata)
    return files
