"""The command that trains robots with frozen partners of the zoo, for zero-shot coordination."""

import json as jsonlib
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from assistax_zoo.commands.train import check_names, parse_changes, parse_seeds, parse_steps, run_training
from assistax_zoo.console import print_json

if TYPE_CHECKING:
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
    registry: Path | None = None,
    json: bool = False,
    json_lines: bool = False,
) -> None:
    """Train robots with the partners of a split's training half, which stay as they are.

    Every partner gets the same share of the simulations, under its own disability setting, and acts with its most
    likely action. The test half is never loaded. The robots are written as policy files, the seeds of one method.

    Args:
        task: Task, such as scratch.
        out: Folder of the run; its folder policies holds a .safetensors file for each seed.
        split: Split whose training half are the partners: an id or the beginning of one; default the release's own.
        algorithm: ppo or sac.
        seeds: How many, numbered from 0, or which: 16, 0-7 or 2,5.
        steps: Environment steps of each robot, such as 500k, 20M or 2e7; rounded up to whole updates.
        backend: Physics: native, mjx, mjx-warp, or auto for the fastest one here.
        num_envs: Simulations of each robot, a multiple of the number of partners; default about the preset's.
        set_: Another hyperparameter, such as learning_rate=3e-4 or torso=gru; repeat it for more.
        checkpoint_every: Updates between checkpoints; default 20 for PPO, 2000 for SAC, whose updates are short.
        updates_per_call: Updates dispatched to the device at once; default 1 for PPO, 20 for SAC.
        resume: Go on with a run that the folder holds.
        registry: Registry to read instead of the installed one.
        json: Print the policy files as JSON at the end.
        json_lines: Print a JSON object for each report on standard output instead of the live line.

    Example:
        assistax-zoo train-ego --task scratch --split half --algorithm ppo --seeds 16 --steps 20M --out runs/ego
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
    if "num_envs" not in changes:
        fitting = _fitting(trainer.num_envs, len(chosen.train), getattr(trainer, "minibatches", 1))
        trainer = preset(ALGORITHMS[algorithm], **changes, num_envs=fitting)
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
    if trainer.num_envs % len(partners) == 0:
        share = trainer.num_envs // len(partners)
        print(f"{len(partners)} partners of {chosen.id}, {share} simulations each", file=sys.stderr)
    run_training(config, backend, out, resume, json_lines, partners)
    files = _write_policies(out, chosen)
    if json or json_lines:
        result = {"run": str(out), "split": chosen.id, "partners": len(partners), "policies": [str(p) for p in files]}
        print_json(result) if json else print(jsonlib.dumps(result), flush=True)
        return
    words = " ".join(f"--policy {path}" for path in files)
    print(f"{len(files)} robots in {out / POLICIES}; next:")
    print(f"assistax-zoo evaluate --task {task} --split both {words}")


def load_partners(registry: "Registry", split: "Split") -> "Partners":
    """Return the humans of a split's training half; no row of the test half is taken from any shard."""
    from population.partners import PartnerGroup, Partners
    from zoo.storage import load_group

    entries = [registry.policy(f"{team}/human") for team in split.train]
    settings = {entry.id: entry.disability for entry in entries}
    return Partners(
        [
            PartnerGroup(group.spec, group.ids, tuple(settings[name] for name in group.ids), group.params)
            for group in load_group(registry, entries)
        ]
    )


def _fitting(simulations: int, partners: int, minibatches: int) -> int:
    """Return the multiple of partners and minibatches that is nearest to a number of simulations."""
    unit = math.lcm(partners, minibatches)
    return max(1, round(simulations / unit)) * unit


def _write_policies(out: Path, split: "Split") -> list[Path]:
    """Write a policy file for each robot of a finished run."""
    from zoo.runs import read_run
    from zoo.storage import write_policy_file

    folder = out / POLICIES
    folder.mkdir(exist_ok=True)
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
