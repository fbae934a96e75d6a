"""Choose checkpoints and seeds by returns with the validation side.

A training keeps snapshots of its robots. All of them play with the validation side of their split.
Each seed's best snapshot is its choice. The best of several seeds is a row of its own: another
method should beat it at an equal sum of steps. The test side is not used.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from assistax_base.files import write_json
from evaluation.cast.cast import choose_partners
from evaluation.ego_training import EgoTraining, ego_metadata
from evaluation.evaluate import cast_robots, evaluate
from evaluation.play.how import PlaySettings
from evaluation.play.progress import OnProgress
from evaluation.record import tables
from evaluation.record.record import Record, Returns
from population.runs.folder import RunFolder
from population.runs.trained import TrainedRun, TrainedTeam, read_teams
from zoo.parameters.storage import write_policy_file
from zoo.registry import Registry
from zoo.schema import Split

CURVE, CHOICES = "validation.parquet", "choices.json"  # of a run's folder
CHOSEN, PLAYED = "chosen", "validation"


@dataclasses.dataclass(frozen=True)
class Choice:
    """A chosen checkpoint."""

    seed: int
    steps: int
    mean: float  # return with the validation side, which choosing makes optimistic
    file: str  # within the run's folder


@dataclasses.dataclass(frozen=True)
class Choices:
    """The choices of a run."""

    split: str
    partners: int  # of the validation side
    episodes: int  # of each pair
    by_seed: tuple[Choice, ...]
    best_of: int  # seeds of a group
    best: tuple[Choice, ...]  # of each group of so many seeds, in their order


def validation_side(registry: Registry, split: Split) -> str:
    """Return the name of a split's validation side, as `choose_partners` takes it.

    Raises:
        ValueError: It has no validation side.
    """
    name = registry.source_of_split(split).validation(split)
    if name is None:
        raise ValueError(
            f"split {split.id} has no validation side, by which checkpoints could be chosen; make "
            "one of three sides: `assistax-zoo split create` with the rule three-sides"
        )
    return name


def choose(
    registry: Registry,
    training: EgoTraining,
    run: TrainedRun,
    how: PlaySettings,
    *,
    best_of: int = 4,
    persons: int | None = None,
    on_progress: OnProgress = None,
) -> Choices:
    """Play a run's snapshots with the validation side; write and return the choices.

    `validation/` has the evaluation of all snapshots, `validation.parquet` a row for each seed and
    step, `chosen/` each seed's best checkpoint, `best-of-N/` the best of each N seeds, and
    `choices.json` says which they are.

    Args:
        registry: The registry of the partners.
        training: The training of the run.
        run: The finished run, with snapshots.
        how: Settings of play.
        best_of: Number of seeds in a group; an incomplete group is ignored.
        persons: Number of persons, if they are the partners.
        on_progress: Called with the progress of the evaluation.

    Raises:
        ValueError: The split has no validation side, or the run no snapshots.
    """
    name = validation_side(registry, training.split)
    if best_of < 1:
        raise ValueError(f"best_of is {best_of}; allowed is 1 or more")
    files = _snapshot_files(training, run)
    partners = choose_partners(registry, how.task, name, None, persons)
    cast = cast_robots(registry, [str(path) for path in files], partners)
    evaluate(cast, how, run.folder / PLAYED, on_progress=on_progress)
    returns = Record.read(run.folder / PLAYED).returns.evaluated_side
    table = _scored(files, returns)
    tables.write_parquet(table.drop("file"), run.folder / CURVE)
    # Of equal means the earlier checkpoint.
    order = table.sort("return", "steps", descending=[True, False])
    best = order.unique("seed", keep="first", maintain_order=True).sort("seed")
    by_seed = [_write(training, run, files, row, CHOSEN) for row in best.iter_rows(named=True)]
    named = {row["seed"]: row for row in best.iter_rows(named=True)}
    chosen = Choices(
        split=training.split.id,
        partners=returns.partners.height,
        episodes=len(returns.episodes),
        by_seed=tuple(by_seed),
        best_of=best_of,
        best=tuple(
            _write(training, run, files, named[won.seed], f"best-of-{best_of}")
            for won in best_of_each(by_seed, best_of)
        ),
    )
    write_json(run.folder / CHOICES, dataclasses.asdict(chosen))
    return chosen


def best_of_each(by_seed: Sequence[Choice], size: int) -> tuple[Choice, ...]:
    """Return the best choice of each full group of `size` consecutive seeds, in order."""
    starts = range(0, len(by_seed) - size + 1, size)
    return tuple(max(by_seed[i : i + size], key=lambda choice: choice.mean) for i in starts)


def _scored(files: Mapping[Path, tuple[int, int, TrainedTeam]], returns: Returns) -> pl.DataFrame:
    """Return a table with seed, steps, mean return and file of each snapshot."""
    scores = dict(zip(returns.egos["ego"], returns.scores.mean(axis=1).tolist(), strict=True))
    rows = [
        {"seed": seed, "steps": steps, "return": scores[str(path)], "file": str(path)}
        for path, (seed, steps, _) in files.items()
    ]
    return pl.DataFrame(rows).sort("seed", "steps")


def _snapshot_files(
    training: EgoTraining, run: TrainedRun
) -> dict[Path, tuple[int, int, TrainedTeam]]:
    """Write a policy file for each snapshot of each seed; return seed, steps and robot by file."""
    folders = sorted(path for path in RunFolder(run.folder).snapshots.glob("*") if path.is_dir())
    files = {}
    for folder in folders:
        for team in read_teams(folder):
            steps = int(team.training["steps"])
            path = folder / f"{team.algorithm}-s{team.seed}.safetensors"
            _write_robot(path, training, run, team)
            files[path] = team.seed, steps, team
    if not files:
        raise ValueError(
            f"{run.folder} has no snapshots to choose among; train into a new folder, and keep some"
        )
    return files


def _write(
    training: EgoTraining,
    run: TrainedRun,
    files: dict[Path, tuple[int, int, TrainedTeam]],
    row: dict[str, Any],
    folder: str,
) -> Choice:
    """Write a chosen checkpoint into a folder of the run, and return the choice."""
    place = Path(folder) / f"{training.config.algorithm}-s{row['seed']}.safetensors"
    _write_robot(run.folder / place, training, run, files[Path(row["file"])][2])
    return Choice(row["seed"], row["steps"], row["return"], str(place))


def _write_robot(path: Path, training: EgoTraining, run: TrainedRun, team: TrainedTeam) -> None:
    metadata = ego_metadata(training, team.seed, run.folder, team.training)
    write_policy_file(path, team.specs["robot"], team.params["robot"], metadata)
