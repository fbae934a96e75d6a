"""Training of a configured run for the command line and the Python interface."""

import contextlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from assistax_base.bounded_reading import parse_json
from assistax_base.extras import optional
from population.config import TrainConfig
from population.runs.trained import TrainedRun, read_trained_run

if TYPE_CHECKING:
    from population.networks.stack import PolicyStack
    from population.partners.frozen import FrozenPartners
    from population.runs.tensorboard import EventFiles
    from population.runs.train import Progress
    from population.runs.wandb_run import WandbRuns


def run_training(
    config: TrainConfig,
    backend: str = "auto",
    folder: Path | str | None = None,
    *,
    partners: "FrozenPartners | None" = None,
    teacher: "PolicyStack | None" = None,
    resume: bool = True,
    tensorboard: Path | str | None = None,
    snapshots: int = 0,
    progress: "Callable[[Progress], None] | None" = None,
) -> TrainedRun:
    """Train a configured run, write its log if one is wanted, and return the finished run.

    Args:
        config: The run's configuration.
        backend: Physics.
        folder: Folder of the run; default a new temporary one.
        partners: Frozen partners of egos, as `config.partners` names them.
        teacher: See `population.runs.train.train`.
        resume: Whether to resume a run that the folder holds.
        tensorboard: Folder for TensorBoard event files, or "wandb:PROJECT".
        snapshots: See `population.runs.train.train`.
        progress: Called after every dispatch.

    Raises:
        ValueError: The packages of the extra `train` are not installed.
    """
    optional("optax", "training", "train")
    optional("orbax.checkpoint", "training", "train")
    from population.runs.train import train

    folder = Path(folder or tempfile.mkdtemp(prefix=f"assistax-{config.task}-"))
    reports = [progress] if progress else []
    with contextlib.ExitStack() as stack:
        files = None
        if tensorboard is not None:
            files = _log(config, folder, str(tensorboard))
            reports.insert(0, stack.enter_context(contextlib.closing(files)))

        def report(state: "Progress") -> None:
            for report_to in reports:
                report_to(state)

        numbers = partners.numbers if partners else None
        env = config.view.make(config.task, backend, version=config.env_version, numbers=numbers)
        train(
            config,
            env,
            folder,
            partners=partners,
            teacher=teacher,
            resume=resume,
            snapshots=snapshots,
            progress=report,
        )
        if files is not None:
            files.catch_up()
    return read_trained_run(folder)


def _log(config: TrainConfig, folder: Path, place: str) -> "EventFiles | WandbRuns":
    """Return the log of a run for a place: TensorBoard's event files, or Weights & Biases."""
    from population.runs.tensorboard import EventFiles
    from population.runs.wandb_run import PREFIX, WandbRuns

    if place.startswith(PREFIX):
        return WandbRuns(config, folder, place.removeprefix(PREFIX))
    return EventFiles(config, folder, Path(place))


def read_preset(path: Path, algorithm: str | None = None) -> tuple[str, dict[str, Any]]:
    """Return the algorithm and the changed hyperparameters of a preset file that a sweep wrote.

    Raises:
        ValueError: The file is not a preset, or is a preset of another algorithm than `algorithm`.
    """
    try:
        content = parse_json(path.read_text(encoding="utf-8"))
        preset_of, changes = content["algorithm"], dict(content["hyperparameters"])
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is not a preset ({type(error).__name__}: {error}); give a JSON object with "
            "algorithm and hyperparameters, such as the preset.json of `assistax-zoo sweep`"
        ) from None
    if algorithm not in (None, preset_of):
        raise ValueError(
            f"algorithm is {algorithm!r}, but {path} is a preset of {preset_of}; give that "
            "algorithm, or leave it out"
        )
    return preset_of, changes
