"""Robots trained with frozen partners of the zoo, for zero-shot coordination."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_base.digest import json_sha256
from assistax_base.files import atomic_write
from assistax_envs.preferences import Told
from evaluation.training_partners import chosen_split, load_partners, older_version
from population.config import MIXED, Member, TrainConfig, check_names, make_run, numbered
from population.hyperparameters import TrainerConfig, robot_preset
from population.networks.stack import PolicyStack, stack_policies
from population.networks.tensors import flatten, row_sha256
from population.runs.folder import RunFolder
from population.runs.logged_run import run_training
from population.runs.trained import TrainedRun
from population.views import View
from zoo.met.claims import side_met
from zoo.met.published import Met
from zoo.parameters.storage import read_policy_file, write_policy_file
from zoo.registry import Registry
from zoo.schema import Split

if TYPE_CHECKING:
    from population.partners.frozen import FrozenPartners
    from population.runs.train import Progress

POLICIES, SPLIT = "policies", "split.json"  # within a run: the trained robots, and their split


@dataclasses.dataclass(frozen=True)
class EgoTraining:
    """Settings of a training of robots, and its partners."""

    config: TrainConfig
    partners: "FrozenPartners"
    split: Split
    met: Met  # the split's training side, which the robots' files say
    preset_envs: int  # simulations of a member in the preset, before they were shared out
    teacher: PolicyStack | None = None  # of each robot, for DAgger

    @property
    def summary(self) -> str:
        """One line of text on the simulations of each partner."""
        return self.partners.sharing(
            self.split.id,
            len(self.split.train),
            self.config.trainer.num_envs,
            self.preset_envs,
            self.config.preferences,
        )


@dataclasses.dataclass(frozen=True)
class TrainedEgos:
    """Robots of one method, one for each seed."""

    run: TrainedRun
    split: Split
    files: tuple[Path, ...]  # a policy file for each seed


def prepare(
    registry: Registry,
    task: str,
    *,
    split: str | Split | None = None,
    partners: str | None = None,
    algorithm: str = "ppo",
    seeds: int | Sequence[int] = 1,
    steps: int = 20_000_000,
    hyperparameters: Mapping[str, Any] | None = None,
    preferences: Sequence[str] = (),
    checkpoint_every: int | None = None,
    updates_per_call: int | None = None,
    told: Told = False,
) -> EgoTraining:
    """Return the training of robots with the partners of a split's training side.

    Every partner gets the same share of the simulations. Unless `num_envs` is among the
    hyperparameters, it is the number nearest to the preset's that can be divided equally.

    Args:
        registry: The registry of the partners.
        task: Task.
        split: Split whose training side are the partners: an id or its beginning, or the split
            itself; by default the release's own.
        partners: "persons" for a new person each episode, "mixed" for teams beside them.
        algorithm: "ppo", "sac", "dagger", or a method: `population.method_presets.METHODS`.
        seeds: Number of seeds, from 0, or the seeds themselves.
        steps: Environment steps of each robot, rounded up to whole updates.
        hyperparameters: Changes of the preset.
        preferences: Preferences of a gentle task's humans, in turns; if none are given, those of
            the split's training side, or all, drawn anew each episode, where it holds none out.
        checkpoint_every: Updates between checkpoints; default the algorithm's.
        updates_per_call: Updates dispatched at once; default the algorithm's.
        told: What robots observe, for rows to compare with; "partner": all numbers of a person.

    Raises:
        ValueError: An argument is not allowed, or the simulations cannot be shared out.
        assistax_base.errors.ZooError: There is no such split, or its partners cannot be read.
    """
    check_names(task)
    trainer = robot_preset(algorithm, **(changes := {**(hyperparameters or {})}))
    chosen = chosen_split(registry, task, split, partners)
    frozen = load_partners(registry, chosen, preferences)
    config = make_run(
        task,
        algorithm,
        [Member(seed, MIXED) for seed in numbered(seeds)],
        steps,
        shared_out(trainer, len(frozen), keep="num_envs" in changes),
        self_play_episodes=0,
        checkpoint_every=checkpoint_every,
        updates_per_call=updates_per_call,
        partners=frozen.ids,
        preferences=preferences or chosen.preferences.get("train", ()),
        env_version=older_version(registry, chosen),
    )
    met = side_met(registry, chosen)
    config = dataclasses.replace(config, told=told, key=training_key(registry, chosen, met))
    return EgoTraining(config, frozen, chosen, met, trainer.num_envs)


def train_egos(
    training: EgoTraining,
    folder: Path | str | None = None,
    *,
    backend: str = "auto",
    resume: bool = True,
    tensorboard: Path | str | None = None,
    snapshots: int = 0,
    progress: "Callable[[Progress], None] | None" = None,
) -> TrainedEgos:
    """Train the robots, write a policy file for each, and return them.

    The run's folder has the form of a run of teams, with only the robot's role and the split. An
    interrupted run continues to the same result.

    Args:
        training: The training of `prepare`.
        folder: Folder of the run; by default a new temporary one.
        backend: Physics backend, or "auto" for the fastest one here.
        resume: Whether to continue a run in the folder.
        tensorboard: Folder for TensorBoard event files, or "wandb:PROJECT".
        snapshots: Number of evenly spaced snapshots, for `evaluation.validation`.
        progress: Called after every dispatch.
    """
    run = run_training(
        training.config,
        backend,
        folder,
        partners=training.partners,
        teacher=training.teacher,
        resume=resume,
        tensorboard=tensorboard,
        snapshots=snapshots,
        progress=progress,
    )
    return write_egos(run, training)


def with_teachers(training: EgoTraining, files: Sequence[Path | str]) -> EgoTraining:
    """Return the training with the robots of policy files as teachers, in turns; for "dagger".

    Raises:
        ValueError: A file holds no robot of the task that is told the preference, or the robots
            have different forms.
        assistax_base.errors.ZooError: A file cannot be read.
    """
    if not files:
        return training
    config, found = training.config, []
    for path in files:
        file = read_policy_file(path)
        view, task = View.claimed(file.metadata), file.metadata.get("task")
        if (task, view) != (config.task, View.PREFERENCE):
            raise ValueError(
                f"the teacher {path} is no robot of {config.task} that is told the preference; "
                "give policy files of such a training"
            )
        found.append((str(path), file.spec, file.params))
    stack, *others = stack_policies(found)
    if others:
        raise ValueError(
            f"the teachers {files[0]} and {others[0].ids[0]} have networks of different forms; "
            "give those of one run"
        )
    stack = stack.take([place % len(stack) for place in range(len(config.members))])
    key = {**config.key, "teacher": row_sha256(flatten(stack.params))}
    return dataclasses.replace(training, config=dataclasses.replace(config, key=key), teacher=stack)


def training_key(registry: Registry, split: Split, met: Met) -> dict[str, str]:
    """Return the digests of a split and of everything that decides its training side's actions.

    Args:
        registry: The registry with the partners' disability settings.
        split: The split.
        met: The training side, with the sha256 of each partner's parameters, or of a person's row
            and program.
    """
    settings = registry.source_of_split(split).settings(split)
    return {"split": split.sha256, "partners": json_sha256([met.partners, settings])}


def shared_out(trainer: TrainerConfig, partners: int, *, keep: bool) -> TrainerConfig:
    """Return hyperparameters whose number of simulations can be shared equally among partners.

    Args:
        trainer: Hyperparameters.
        partners: Number of partners.
        keep: Whether to keep the number of simulations, because the user chose it.

    Raises:
        ValueError: The number is to be kept and cannot be shared equally.
    """
    from population.partners.frozen import fitting_envs

    fitting = fitting_envs(trainer.num_envs, partners, getattr(trainer, "minibatches", 1))
    if not keep:
        return dataclasses.replace(trainer, num_envs=fitting)
    if trainer.num_envs % partners:
        raise ValueError(
            f"num_envs is {trainer.num_envs} with {partners} partners; every partner gets the same "
            f"share, so choose {fitting}, or let it be chosen"
        )
    return trainer


def write_egos(run: TrainedRun, training: EgoTraining) -> TrainedEgos:
    """Write the split of a finished run and a policy file for each robot; return the robots."""
    split = training.split
    # What publishing reads: an ego's entry names the split it was trained with, and its sha256.
    atomic_write(run.folder / SPLIT, split.model_dump_json().encode())
    [(_, robots)] = run.policies.items()
    files = []
    for row, member in enumerate(run.config.members):
        files.append(run.folder / POLICIES / f"{run.config.algorithm}-s{member.seed}.safetensors")
        metadata = ego_metadata(training, member.seed, run.folder, run.training)
        write_policy_file(files[-1], robots.spec, robots.row(row), metadata)
    return TrainedEgos(run, split, tuple(files))


def ego_metadata(
    training: EgoTraining, seed: int, folder: Path, trained: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the metadata of a robot's policy file: task, algorithm, seed, split, training."""
    return {
        "task": training.config.task,
        "algorithm": training.config.algorithm,
        "seed": seed,
        "split": training.split.id,
        "training": {"run": folder.resolve().name, "key": RunFolder(folder).key, **trained},
        **training.met.claim,
        **training.config.view.claim,
    }
