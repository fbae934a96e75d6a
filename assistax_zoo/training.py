"""Training of robots against the zoo's partners."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_zoo.zoos import Zoo, open_zoo

if TYPE_CHECKING:
    from evaluation.ego_training import TrainedEgos
    from population.train import Progress


def train_ego(
    task: str,
    algorithm: str = "ppo",
    *,
    folder: Path | str | None = None,
    split: str | None = None,
    seeds: int | Sequence[int] = 1,
    steps: int = 20_000_000,
    hyperparameters: Mapping[str, Any] | None = None,
    backend: str = "auto",
    resume: bool = True,
    zoo: "str | Path | Zoo | None" = None,
    progress: "Callable[[Progress], None] | None" = None,
) -> "TrainedEgos":
    """Train robots with the partners of a split's training half, which stay as they are.

    Args:
        task: Task, such as "scratch".
        algorithm: "ppo" or "sac".
        folder: Folder of the run; one that was interrupted goes on. Default a new temporary one.
        split: Split whose training half are the partners; default the release's own.
        seeds: How many, numbered from 0, or which.
        steps: Environment steps of each robot, rounded up to whole updates.
        hyperparameters: Changes of the preset, such as {"learning_rate": 3e-4, "torso": "gru"}.
        backend: Physics, or "auto" for the fastest one here.
        resume: Go on with a run that the folder holds.
        zoo: Where the partners come from, as in `open_zoo`.
        progress: Called after every dispatch to the device.

    Returns:
        The run; its `files`, a policy for each seed, are what `evaluate` takes.

    Raises:
        ValueError: An argument is not allowed, or the folder holds another run.
        ZooError: There is no such split, or its partners cannot be read.
    """
    from evaluation.ego_training import prepare, train_egos

    registry = open_zoo(zoo).registry
    training = prepare(
        registry,
        task,
        split=split,
        algorithm=algorithm,
        seeds=seeds,
        steps=steps,
        hyperparameters=hyperparameters,
    )
    return train_egos(training, folder, backend=backend, resume=resume, progress=progress)
