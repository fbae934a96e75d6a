"""A row of the league from nothing: training, choice by validation, the test side, its record.

Its seeds may be trained in parts, each on a card or a machine of its own, and put together after.
"""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from assistax_base.bounded_reading import parse_json
from assistax_base.digest import sha256
from assistax_base.files import write_json
from assistax_envs.preferences import PREFERRED
from assistax_workshop.gates.persons.robots import WITH_PERSONS, recipe_with_persons
from assistax_zoo.shell.console import StudyLine, TrainingLine
from evaluation.cast.cast import choose_partners
from evaluation.ego_training import EgoTraining, prepare, train_egos, with_teachers
from evaluation.evaluate import cast_robots, evaluate
from evaluation.figures.contrasts import read_contrasts
from evaluation.figures.summary import read_summary
from evaluation.play.how import PlaySettings
from evaluation.record.manifest import describe_machine, write_run
from evaluation.record.record import Record
from evaluation.training_partners import load_partners
from evaluation.validation import CHOICES, choose, validation_side
from population.config import MIXED
from population.runs.trained import TrainedRun
from tools.league.parts import RECORD, TRAINED, Part, picked, teachers
from tools.league.rows import Row, rows
from zoo.locations import cache_root
from zoo.registry import Registry
from zoo.schema import PolicyEntry, Split

Side = Literal["test", "train"]
RUNS, TRAINING_SIDE = "runs", "training-side"  # of a task's folder


@dataclasses.dataclass(frozen=True)
class Sizes:
    """How much is trained and played."""

    seeds: tuple[int, ...]
    steps: int  # of each robot
    best_of: int = 4
    checkpoints: int = 10  # among which validation chooses
    sampled: int = 16  # partners of the test side that have best responses
    persons: int | None = None  # of the test side, where they are the partners
    validators: int | None = None  # of the validation side
    references: bool = True  # whether zero, random and script play too
    changes: dict[str, Any] = dataclasses.field(default_factory=dict)  # of the preset


@dataclasses.dataclass(frozen=True)
class Making:
    """One row on one task."""

    registry: Registry
    row: Row
    how: PlaySettings
    split: Split  # of the league
    sizes: Sizes
    folder: Path  # of the task
    command: str
    contrasts: Path | None = None
    side: Side = "test"  # side of the partners that have best responses
    part: Part | None = None  # of the seeds; None if all are trained at once

    @property
    def learned(self) -> Split:
        """The split that robots learn with."""
        return self.split if self.row.mixed else self._alone

    @property
    def played(self) -> Split:
        """The split that the row plays, which is of the persons alone for some rows."""
        return self._alone if self.row.of_persons else self.split

    @property
    def _alone(self) -> Split:
        return self.registry.source_of_split(self.split).alone(self.split)

    @property
    def place(self) -> Path:
        """The folder of rows that play with this side."""
        return self.folder if self.side == "test" else self.folder / TRAINING_SIDE

    @property
    def runs(self) -> Path:
        """The folder of the row's trainings, and of its record."""
        return self.place / RUNS / self.row.name

    @property
    def training(self) -> Path:
        """The folder of the training that the row needs, which may be another row's."""
        folder = self.folder / RUNS / self.row.of
        return folder / (self.part.name if self.part else TRAINED)


@dataclasses.dataclass(frozen=True)
class Made:
    """Robots of a row, with the cost of their training."""

    files: list[str]
    seeds: list[int] = dataclasses.field(default_factory=list)
    steps: int = 0  # of each robot
    total_steps: int = 0
    device: str | None = None

    @classmethod
    def of(cls, files: list[str], runs: Sequence[TrainedRun]) -> "Made":
        """Return robots with the facts of their trainings."""
        return cls(
            files,
            [member.seed for run in runs[:1] for member in run.config.members],
            runs[0].training["steps"],
            sum(run.training["steps"] * len(run.config.members) for run in runs),
            runs[0].training["device"],
        )


def make_row(making: Making) -> dict[str, Any]:
    """Train, choose and play a row, and return its record, which lies beside its trainings.

    An interrupted stage continues, and a finished stage is not repeated. A part of a row is trained
    and chosen alone; its record lies in its folder.

    Raises:
        ValueError: The split has no validation side, or the folder has another row.
    """
    validation_side(making.registry, making.split)
    if making.side != "test" and making.row.source != "each":
        raise ValueError(
            f"side is {making.side!r} for row {making.row.name!r}; only best responses are of "
            "another side: leave side out, or play robots with that side by `evaluate --split`"
        )
    digest = read_contrasts(making.contrasts)[1] if making.contrasts else None
    seconds: dict[str, float] = {}
    part, played = making.part, dict[str, Any]()
    made = _joined(making, seconds) if part and part.joins else _robots(making, seconds)
    if part is None or part.joins:
        _evaluate(making, made.files, making.place / making.row.name, seconds)
        if making.side == "train":
            _play_beside(making, seconds)
        summary: Any = read_summary(making.place / making.row.name)
        mean = getattr(summary, f"m_{making.side}")
        # Of best responses with all partners, not with each one's own.
        played[f"m_{making.side}"] = {"mean": mean.mean, "mean_ci": mean.mean_ci}
    path = (making.runs if played else making.training) / RECORD
    before = parse_json(path.read_text(encoding="utf-8")) if path.is_file() else {}
    # A stage that was finished before took no time now, so its earlier minutes count.
    old = before.get("device_minutes", {})
    minutes = {name: max(round(s / 60, 2), old.get(name, 0.0)) for name, s in seconds.items()}
    record = {
        "row": making.row.name,
        "task": making.how.task,
        "command": making.command,
        "split": making.split.id,
        "training_split": making.learned.id,
        "seeds": made.seeds,
        "robots": len(made.files),
        "steps": made.steps,
        "total_steps": made.total_steps,
        "device": made.device,
        "device_minutes": minutes,
        "device_minutes_in_all": round(sum(minutes.values()), 2),
        "robot_files": {Path(file).name: file for file in made.files},
        "contrasts": digest,
        **played,
        "machine": describe_machine(),
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, record)
    return record


def _robots(making: Making, seconds: dict[str, float]) -> Made:
    """Train the robots of a row, or choose those that are trained already."""
    row, split = making.row, making.learned
    if making.part and row.source != "train":
        raise ValueError(
            f"part is {making.part.number}/{making.part.count} for row {row.name!r}; allowed are "
            "parts of rows that learn with the training side: leave part out"
        )
    if row.source == "published":
        return Made([_best_published(making, seconds)])
    if row.source == "each":
        humans, place = sampled(making), making.runs
        # One program for all: the first robot has the first person.
        if making.registry.source_of_split(split).word:
            split = split.model_copy(update={"train": tuple(human.team for human in humans)})
            run, files = _trained(making, split, place / TRAINED, seconds)
            return Made.of(files, [run])
        files, runs = [], []
        for human in humans:
            own = split.model_copy(update={"train": (human.team,)})
            name = human.team.partition("/")[2]
            run, made = _trained(making, own, place / name, seconds)
            files += made
            runs.append(run)
        return Made.of(files, runs)
    own = split.model_copy(update={"train": split.test}) if row.source == "test" else split
    run, files = _trained(making, own, making.training, seconds)
    return Made.of(files, [run])


def _joined(making: Making, seconds: dict[str, float]) -> Made:
    """Put the parts of a row together, as if its seeds had been trained at once.

    Raises:
        ValueError: The row has no parts, or these are not of its seeds.
        FileNotFoundError: A part is not finished; says which.
    """
    row, sizes, part = making.row, making.sizes, making.part
    assert part is not None
    if row.source not in ("train", "best-of"):
        raise ValueError(f"row {row.name!r} is not trained in parts; leave part out")
    folder = making.folder / RUNS / row.of
    chosen, records = part.join(folder, making.split.id, sizes.seeds, sizes.best_of)
    for record in records:
        for name, minutes in record["device_minutes"].items():
            seconds[name] = seconds.get(name, 0.0) + 60 * minutes
    files = [str((making.training / choice.file).resolve()) for choice in picked(row, chosen)]
    total, first = sum(record["total_steps"] for record in records), records[0]
    return Made(files, list(sizes.seeds), first["steps"], total, first["device"])


def sampled(making: Making) -> list[PolicyEntry]:
    """Return the partners of the side that have best responses: a draw, fewer part of more."""
    _, humans = _partners(making, making.side, making.sizes.persons)
    drawn = sorted(humans, key=lambda human: sha256(human.id.encode()))[: making.sizes.sampled]
    return sorted(drawn, key=lambda human: human.id)


def _partners(
    making: Making, side: str, persons: int | None
) -> tuple[Split, Sequence[PolicyEntry]]:
    name = f"{making.played.id}:{side}"
    return choose_partners(making.registry, making.how.task, name, None, persons)


def _learning(making: Making, split: Split) -> EgoTraining:
    """Return the training of robots with a split's training side."""
    row, sizes = making.row, making.sizes
    alone = row.source == "each" and bool(making.registry.source_of_split(split).word)
    seeds = making.part.seeds(sizes.seeds) if making.part else sizes.seeds
    recipe: dict[str, Any] = {}
    # The recipe is of PPO's hyperparameters for learning from rewards.
    if split.task in PREFERRED and row.algorithm != "sac" and not row.teacher:
        recipe = recipe_with_persons(split.task)
    if not making.registry.source_of_split(split).word:
        # Every team gets the same share of the preset's simulations, and teams have no own will.
        recipe = {name: value for name, value in recipe.items() if name not in WITH_PERSONS}
    learning = prepare(
        making.registry,
        split.task,
        split=split,
        partners=MIXED if row.mixed else None,
        algorithm=row.algorithm,
        seeds=len(split.train) if alone else seeds,
        steps=sizes.steps,
        hyperparameters={**recipe, **sizes.changes},
        told=row.told,
    )
    if alone:
        partners = load_partners(making.registry, split, each=True)
        learning = dataclasses.replace(learning, partners=partners)
    if row.teacher:
        return with_teachers(learning, teachers(making.folder / RUNS / row.teacher, row))
    return learning


def _trained(
    making: Making, split: Split, folder: Path, seconds: dict[str, float]
) -> tuple[TrainedRun, list[str]]:
    """Train with a split's training side, and return the robots that validation chooses.

    The mirror's robots and best responses met the test side. They are bounds and no methods, and
    stay as they are at the end of their training.
    """
    row, sizes, learning = making.row, making.sizes, _learning(making, split)
    watched = "validation" in row.stages
    line = TrainingLine(f"{row.stage('training')} in {folder}")
    kept: dict[str, Any] = {"snapshots": sizes.checkpoints * watched, "progress": line}
    with line:
        egos = train_egos(learning, folder, backend=making.how.backend, **kept)
    run = egos.run
    seconds["training"] = seconds.get("training", 0.0) + float(run.training["seconds"])
    ends = [str(path) for path in egos.files]
    if not watched:
        return run, ends
    start = time.perf_counter()
    playing: dict[str, Any] = {"best_of": sizes.best_of, "persons": sizes.validators}
    with StudyLine(row.stage("validation")) as line:
        chosen = choose(making.registry, learning, run, making.how, on_progress=line, **playing)
    seconds["validation"] = time.perf_counter() - start
    return run, [str(run.folder / choice.file) for choice in picked(row, chosen)]


def _best_published(making: Making, seconds: dict[str, float]) -> str:
    """Return the published robot that is best with the validation side.

    Candidates are the egos of the release, and the robots of its teams but of those that test or
    validate: these know a partner of their side.
    """
    registry, split, task = making.registry, making.split, making.how.task
    release, others = split.release, {*split.test, *split.validation}
    robots = [
        entry
        for entry in registry.select(task=task, role="robot")
        if entry.release == release and (entry.trained_against or entry.team not in others)
    ]
    if not robots:
        raise ValueError(f"release {release} has no robot of {task} that could be the best one")
    partners = _partners(making, "validation", making.sizes.validators)
    cast = cast_robots(registry, [entry.id for entry in robots], partners)
    start, folder = time.perf_counter(), making.runs / "validation"
    with StudyLine(making.row.stage("validation")) as line:
        evaluate(cast, making.how, folder, include_own=True, on_progress=line)
    seconds["validation"] = time.perf_counter() - start
    returns = Record.read(folder).returns.evaluated_side
    return str(returns.egos["ego"][int(returns.scores.mean(axis=1).argmax())])


def _play_beside(making: Making, seconds: dict[str, float]) -> None:
    """Play the best robots of the league's methods with the partners that have best responses."""
    for path in sorted((making.folder / RUNS).glob(f"*/{TRAINED}/{CHOICES}")):
        row = rows().get(path.parent.parent.name)
        if row and row.source == "train" and not row.told:
            best = parse_json(path.read_text(encoding="utf-8"))["best"]
            files = [str(path.parent / choice["file"]) for choice in best]
            _evaluate(making, files, making.place / row.name, seconds)


def _evaluate(making: Making, files: list[str], folder: Path, seconds: dict[str, float]) -> None:
    """Play robots with the row's partners into a folder."""
    row = making.row
    split, humans = _partners(making, making.side, making.sizes.persons)
    if row.source == "each":
        humans = sampled(making)
    knowing = row.source in ("test", "each")  # robots that train with the test side
    references = making.sizes.references and not knowing and not row.told
    cast = cast_robots(making.registry, files, (split, humans), baselines=references)
    start, kept = time.perf_counter(), cache_root() / "references" if references else None
    playing: dict[str, Any] = {"include_own": knowing, "references": kept}
    with StudyLine(row.stage("evaluation")) as line:
        summary = evaluate(cast, making.how, folder, on_progress=line, **playing)
    seconds["evaluation"] = seconds.get("evaluation", 0.0) + time.perf_counter() - start
    write_run(folder, making.command, summary.env_steps_per_second is not None)
