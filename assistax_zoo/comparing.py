"""Methods compared: two of them, or as a file names them before the test side is played."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from assistax_zoo.results import CrossPlayResult, EvaluationResult, brief, load_result
from evaluation.figures.comparable import (
    ComparisonSummary,
    Evaluated,
    comparable,
    summarise_comparison,
)
from evaluation.figures.contrasts import (
    ContrastFigures,
    Pair,
    contrast_figures,
    named_pairs,
    read_contrasts,
)
from evaluation.figures.league import row_folders
from evaluation.record import tables
from evaluation.record.record import Record


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class Comparison(ComparisonSummary):
    """Method a minus method b: paired differences over the same partners and episodes.

    Attributes:
        task: That both do.
        test: The difference with the common partners of the test side, None if none played: `mean`
            with its interval, and `means`, `seeds` and `partners` behind it.
        train: The same with partners of the training side.
        validation: The same with partners of the validation side.
        met: Whom robots of either met in training, who are left out of both.
        care: Of a gentle task, on the test side: differences of caring success, discomfort and
            violations.
        slopes: The adaptation slopes of a and of b, by wish.
        notes: What a reader has to know of the figures.

    Examples:
        >>> compare(result, result)
        Comparison(scratch: test partners 0.0, train partners 0.0)
    """

    task: str

    def to_json(self) -> dict[str, Any]:
        """Return the figures as `compare --json` prints them."""
        return tables.to_json(self)

    def __repr__(self) -> str:
        sides = {"test": self.test, "validation": self.validation, "train": self.train}
        parts = [f"{side} partners {brief(figure)}" for side, figure in sides.items() if figure]
        return f"Comparison({self.task}: {', '.join(parts)})"


def compare(
    a: "EvaluationResult | Path | str", b: "EvaluationResult | Path | str", *, seed: int = 0
) -> Comparison:
    """Compare two methods: paired differences a - b over the same partners and episodes.

    These are the partners that both have in common, without those that a robot of either met.

    Args:
        a: A result, or its folder.
        b: Another, of the same task, split, episodes and seed.
        seed: Of the bootstrap.

    Raises:
        ValueError: They were not evaluated alike.
        TypeError: One is neither a result nor a folder.
        FormatError: One is the name of a robot.

    Examples:
        >>> compare(result, result.folder).test.mean
        0.0
    """
    compared = comparable([_evaluation_of(a), _evaluation_of(b)])
    summary = summarise_comparison(*compared.records, seed=seed)
    notes = tuple(dict.fromkeys((*summary.notes, *compared.notes)))
    summary = dataclasses.replace(summary, notes=notes, met=compared.met)
    return Comparison(**vars(summary), task=compared.methods[0].summary.task)


def _evaluation_of(result: "EvaluationResult | Path | str") -> Evaluated:
    """Return a result, or that of a folder, which must be an evaluation's."""
    loaded = load_result(result) if isinstance(result, Path | str) else result
    if not isinstance(loaded, EvaluationResult | CrossPlayResult):
        raise TypeError(f"{result!r} is neither a result nor the folder of one")
    if isinstance(loaded, CrossPlayResult):
        raise ValueError(f"{loaded.folder} holds a cross-play; compare takes evaluations")
    record = Record(loaded.episodes, loaded.folder)
    return Evaluated(str(loaded.folder), loaded.summary, record)


def compare_named(
    contrasts: Path | str, folders: Sequence[Path | str], *, seed: int = 0
) -> ContrastFigures:
    """Return the figures of a file's named contrasts, on the test side.

    Each is a method less a baseline with the same partners and episodes: an interval that resamples
    seeds and partners, a p-value, the same corrected for all named contrasts by Holm, and the
    difference that is found in 80% of repetitions. Methods beside a baseline of the file that it
    does not name are shown too, as not named.

    Args:
        contrasts: The file, TOML or JSON, see `evaluation.figures.contrasts`.
        folders: Finished evaluations, one for each method and task, whose folders' names are the
            methods'; a league's folder of a task stands for its rows.
        seed: Of the resamples.

    Raises:
        FormatError: The file is none of contrasts.
        ValueError: Two folders are of one method and task, or methods were not evaluated alike.

    Examples:
        >>> import json
        >>> one = {"task": "scratch", "split": "half", "method": "gru", "baseline": "ppo"}
        >>> content = {"schema": 1, "alpha": 0.05, "contrasts": [{**one, "seeds": 16}]}
        >>> _ = Path("contrasts.json").write_text(json.dumps(content))
        >>> compare_named("contrasts.json", [result.folder]).missing
        ('gru less ppo on scratch, return',)
    """
    path = Path(contrasts)
    file, digest = read_contrasts(path)
    results: dict[tuple[str, str], Evaluated] = {}
    for folder in (row for f in map(Path, folders) for row in row_folders(f).values() or [f]):
        result = _evaluation_of(folder)
        key = result.summary.task, folder.resolve().name
        if key in results:
            raise ValueError(
                f"{folder} and {results[key].name} are both {key[1]} on {key[0]}; a folder is "
                "named for its method, so give one for each method and task"
            )
        results[key] = result
    pairs: dict[tuple[str, str, str], Pair] = {}
    notes: list[str] = []
    for task, method, baseline in named_pairs(file, list(results)):
        compared = comparable([results[task, method], results[task, baseline]])
        split = compared.methods[0].summary.split
        pairs[task, method, baseline] = Pair(*compared.records, split.id if split else None)
        notes += [f"{method} less {baseline} on {task}: {note}" for note in compared.about]
        notes += [note for note in compared.notes if note not in compared.about]
    figures = contrast_figures(file, digest, path.name, pairs, seed=seed)
    return dataclasses.replace(figures, notes=tuple(dict.fromkeys((*figures.notes, *notes))))
