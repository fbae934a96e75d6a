"""Training of teams, and of robots against the zoo's partners."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.shell.console import TrainingLine, chosen_progress
from assistax_zoo.zoos import Zoo, open_zoo

if TYPE_CHECKING:
    from evaluation.ego_training import TrainedEgos
    from population.runs.train import Progress
    from population.runs.trained import TrainedRun


def train(
    task: str,
    algorithm: str = "ippo",
    *,
    folder: Path | str | None = None,
    disabilities: Sequence[str] = ("d1",),
    seeds: int | Sequence[int] = 1,
    steps: int = 10_000_000,
    hyperparameters: Mapping[str, Any] | None = None,
    backend: str = "auto",
    resume: bool = True,
    tensorboard: Path | str | None = None,
    progress: "bool | Callable[[Progress], None]" = True,
    **options: Any,
) -> "TrainedRun":
    """Train teams of a robot and a human, every seed with every disability setting, in one program.

    Args:
        task: Task, such as "scratch".
        algorithm: Preset of hyperparameters: "ippo", "mappo", "isac", "masac" or "mep".
        folder: Folder of the run; one that was interrupted goes on. Default a new temporary one.
        disabilities: Settings of the human, such as ("d1", "d3").
        seeds: How many, numbered from 0, or which.
        steps: Environment steps of 20 ms of each team, rounded up to whole updates.
        hyperparameters: Changes of the preset, such as {"learning_rate": 3e-4, "torso": "gru"}.
        backend: Physics, or "auto" for the fastest one here.
        resume: Continue the run that the folder holds.
        tensorboard: Folder for TensorBoard event files, or "wandb:PROJECT".
        progress: Show it, or a function that is called after every dispatch to the device.
        **options: `self_play_episodes` of each team's final evaluation, 16 or none (0);
            `checkpoint_every` and `updates_per_call`, in updates, default the algorithm's.

    Returns:
        The run: its `folder`, which `assistax-zoo publish` takes, and `self_play` of `names`.

    Raises:
        ValueError: An argument is not allowed, or the folder holds another run.
        population.runs.train.DivergedError: A loss became NaN or infinite.

    Examples:
        >>> tiny = {"num_envs": 4, "rollout_steps": 8, "minibatches": 2, "hidden": (8, 8)}
        >>> run = train("scratch", steps=64, hyperparameters=tiny, backend="native",
        ...             self_play_episodes=0, progress=False)
        >>> run.names
        ('scratch/ippo-d1-s0',)
    """
    from population.config import check_names, make_members, make_run, numbered
    from population.hyperparameters import preset
    from population.runs.logged_run import run_training

    check_names(task, disabilities)
    members = make_members(numbered(seeds), disabilities)
    trainer = preset(algorithm, **(hyperparameters or {}))
    config = make_run(task, algorithm, members, steps, trainer, **options)
    line = TrainingLine(f"{task} {algorithm}")
    with chosen_progress(progress, line) as report:
        return run_training(
            config, backend, folder, resume=resume, tensorboard=tensorboard, progress=report
        )


def train_ego(
    task: str,
    algorithm: str = "ppo",
    *,
    folder: Path | str | None = None,
    split: str | None = None,
    partners: str | None = None,
    seeds: int | Sequence[int] = 1,
    steps: int = 20_000_000,
    hyperparameters: Mapping[str, Any] | None = None,
    preferences: Sequence[str] = (),
    told: bool = False,
    teacher: Sequence[Path | str] = (),
    backend: str = "auto",
    resume: bool = True,
    zoo: "str | Path | Zoo | None" = None,
    progress: "bool | Callable[[Progress], None]" = True,
) -> "TrainedEgos":
    """Train robots with the partners of a split's training side, which stay as they are.

    Args:
        task: Task, such as "scratch".
        algorithm: "ppo", "sac", "dagger", or a method, such as "asymmetric" (docs/methods.md).
        folder: Of the run; one that was interrupted goes on. Default a new temporary one.
        split: Split whose training side are the partners; default the release's own.
        partners: "persons" for a new person of the training side each episode; "mixed" for persons
            in half of the simulations and the side's teams in the other half.
        seeds: How many, numbered from 0, or which.
        steps: Environment steps of each robot, rounded up to whole updates.
        hyperparameters: Changes of the preset, such as {"learning_rate": 3e-4, "torso": "gru"}.
        preferences: Preferences of a gentle task's humans, such as ("p2", "p3"), in turns; default
            those of the split's training side, or all, drawn anew each episode.
        told: Let the robot observe the human's preference: a row to compare with, and no robot.
        teacher: Policy files of told robots, which the robots imitate in turns; for "dagger".
        backend: Physics, or "auto" for the fastest one here.
        resume: Continue the run that the folder holds.
        zoo: Where the partners come from, as in `open_zoo`.
        progress: Show it, or a function that is called after every dispatch to the device.

    Returns:
        The run; its `files`, a policy for each seed, are what `evaluate` takes.

    Raises:
        ValueError: An argument is not allowed, or the folder holds another run.
        ZooError: There is no such split, or its partners cannot be read.

    Examples:
        >>> tiny = {"rollout_steps": 2, "minibatches": 1, "hidden": (8, 8)}
        >>> run = train_ego("scratch", steps=1, hyperparameters=tiny, backend="native",
        ...                 progress=False)
        >>> [path.name for path in run.files]
        ['ppo-s0.safetensors']
    """
    from evaluation.ego_training import prepare, train_egos, with_teachers

    registry = open_zoo(zoo).registry
    training = prepare(
        registry,
        task,
        split=split,
        partners=partners,
        algorithm=algorithm,
        seeds=seeds,
        steps=steps,
        hyperparameters=hyperparameters,
        preferences=preferences,
        told=told,
    )
    training = with_teachers(training, teacher)
    line = TrainingLine(f"{task} {algorithm}")
    with chosen_progress(progress, line) as report:
        return train_egos(training, folder, backend=backend, resume=resume, progress=report)
