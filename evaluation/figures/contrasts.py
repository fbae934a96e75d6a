"""Contrasts of methods, named in a file before the test side is played, and their figures.

The file is TOML or JSON:

    schema = 1
    alpha = 0.05                       # chance that any of the contrasts is found wrongly

    [[contrasts]]
    task = "gentle_scratch"
    split = "gentle_scratch/persons-s0-v1-9c64d228"
    method = "gru"                     # less
    baseline = "ppo"
    metric = "return"                  # or caring_success, discomfort, violations
    seeds = 32                         # of either
"""

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from assistax_base.bounded_reading import parse_json, read_text
from assistax_base.digest import sha256
from assistax_base.errors import FormatError
from assistax_base.validated import first_problem
from evaluation.figures.league import FIRST, LAST
from evaluation.figures.metrics import Difference, paired_difference
from evaluation.figures.metrics.caring import SHARES
from evaluation.figures.metrics.inference import holm, mean_test
from evaluation.record.columns import measures_care
from evaluation.record.record import Record, Returns

MOST_BYTES = 1024 * 1024
METRICS = {"return": "return", **SHARES}  # and their columns
Metric = Literal["return", "caring_success", "discomfort", "violations"]
_Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, allow_inf_nan=False)


class Contrast(_Strict):
    """A method less a baseline."""

    task: _Name
    split: _Name
    method: _Name
    baseline: _Name
    metric: Metric = "return"
    seeds: Annotated[int, Field(ge=1)]  # of either

    @property
    def words(self) -> str:
        """The contrast as text for readers."""
        return f"{self.method} less {self.baseline} on {self.task}, {self.metric}"


class ContrastsFile(_Strict):
    """Contrasts that are tested together."""

    schema_: Annotated[Literal[1], Field(alias="schema")]
    alpha: Annotated[float, Field(gt=0, lt=1)]
    contrasts: Annotated[tuple[Contrast, ...], Field(min_length=1, strict=False)]

    @model_validator(mode="after")
    def _distinct(self) -> "ContrastsFile":
        words = [contrast.words for contrast in self.contrasts]
        if twice := next((text for text in words if words.count(text) > 1), None):
            raise ValueError(f"{twice} is named twice")
        for contrast in self.contrasts:
            if contrast.method == contrast.baseline:
                raise ValueError(f"{contrast.words}: a method is not tested against itself")
        return self


@dataclasses.dataclass(frozen=True)
class ContrastFigure:
    """Result of a contrast on the test side."""

    task: str
    method: str
    baseline: str
    metric: str
    named: bool  # whether the file names it, with so many seeds; else nothing is corrected
    seeds: tuple[int, int]
    partners: int
    difference: Difference  # its intervals resample seeds and partners
    p: float  # of `evaluation.figures.metrics.inference.mean_test`
    p_holm: float | None  # over all named contrasts
    found: bool | None  # whether p_holm is at most alpha
    detectable: float  # the true difference that is found in 80%, at alpha alone
    detectable_holm: float  # the same at Holm's strictest step


@dataclasses.dataclass(frozen=True)
class ContrastFigures:
    """The contrasts of a file."""

    file: str
    sha256: str  # of the file's bytes
    alpha: float
    contrasts: tuple[ContrastFigure, ...]
    missing: tuple[str, ...]  # named, and not among the folders; they count as p = 1
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Pair:
    """Two methods that were evaluated alike, without partners that a robot of either met."""

    method: Record
    baseline: Record
    split: str | None


def read_contrasts(path: Path) -> tuple[ContrastsFile, str]:
    """Return the contrasts of a file, and the sha256 of its bytes.

    Raises:
        FormatError: The file is missing or malformed.
    """
    remedy = "docs/league.md shows such a file"
    text = read_text(path, MOST_BYTES, FormatError, "contrasts", remedy)
    try:
        content = parse_json(text) if path.suffix == ".json" else tomllib.loads(text)
        return ContrastsFile.model_validate(content), sha256(text.encode())
    except ValidationError as error:
        found = first_problem(error)
    except (ValueError, RecursionError) as error:
        found = f"{type(error).__name__}: {error}"
    expected = "named contrasts in TOML or JSON"
    raise FormatError(f"contrasts {path}", expected, found, remedy, "nothing was compared")


def contrast_figures(
    file: ContrastsFile,
    digest: str,
    name: str,
    pairs: Mapping[tuple[str, str, str], Pair],
    *,
    seed: int = 0,
) -> ContrastFigures:
    """Return the figures of a file's contrasts, and of other pairs.

    Args:
        file: The contrasts.
        digest: The file's sha256.
        name: The file's name, for readers.
        pairs: Pairs by task, method and baseline. Pairs that the file does not name are marked.
        seed: Seed of the resamples.

    Raises:
        ValueError: A pair was played on another split, or its tables lack the metric.
    """
    played: list[ContrastFigure | None] = []
    for contrast in file.contrasts:
        pair = pairs.get((contrast.task, contrast.method, contrast.baseline))
        if pair and pair.split != contrast.split:
            raise ValueError(
                f"{contrast.words} was played on split {pair.split}, and {name} names "
                f"{contrast.split}; evaluate both on that"
            )
        played.append(_figure(contrast, pair, file, seed, named=True) if pair else None)
    both = list(zip(file.contrasts, played, strict=True))
    missing = tuple(contrast.words for contrast, figure in both if figure is None)
    notes = [
        f"{contrast.words}: {' and '.join(map(str, figure.seeds))} seeds, and {contrast.seeds} of "
        "either were named; counts as p = 1"
        for contrast, figure in both
        if figure and not figure.named
    ]
    chances = holm([figure.p if figure and figure.named else 1.0 for figure in played])
    corrected = [
        dataclasses.replace(figure, p_holm=p, found=p <= file.alpha) if figure.named else figure
        for figure, p in zip(played, chances, strict=True)
        if figure
    ]
    named = {(c.task, c.method, c.baseline) for c in file.contrasts}
    for (task, method, baseline), pair in pairs.items():
        if (task, method, baseline) not in named:
            other = Contrast.model_construct(
                task=task, split="", method=method, baseline=baseline, metric="return", seeds=1
            )
            corrected.append(_figure(other, pair, file, seed, named=False))
            notes.append(f"{other.words}: not named in {name}, hence not corrected")
    if missing:
        notes.append(f"named and not played, they count as p = 1: {'; '.join(missing)}")
    return ContrastFigures(name, digest, file.alpha, tuple(corrected), missing, tuple(notes))


def _figure(
    contrast: Contrast, pair: Pair, file: ContrastsFile, seed: int, *, named: bool
) -> ContrastFigure:
    sides = [_test_side(record, contrast) for record in (pair.method, pair.baseline)]
    a, b = (_values(returns, contrast) for returns in sides)
    groups, common = sides[0].groups, sides[0].common_starts
    difference = paired_difference(a, b, groups, common_starts=common, seed=seed)
    test = mean_test(a.mean(axis=2), b.mean(axis=2), groups)
    return ContrastFigure(
        *(contrast.task, contrast.method, contrast.baseline, contrast.metric),
        # With fewer seeds it is another contrast than the one that was named.
        named=named and min(len(a), len(b)) >= contrast.seeds,
        seeds=(len(a), len(b)),
        partners=a.shape[1],
        difference=difference,
        p=test.p,
        p_holm=None,
        found=None,
        detectable=test.detectable(file.alpha),
        detectable_holm=test.detectable(file.alpha / len(file.contrasts)),
    )


def _test_side(record: Record, contrast: Contrast) -> Returns:
    side = (record.returns.partners["side"] == "test").fill_null(value=False).to_numpy()
    if not side.any():
        raise ValueError(f"{contrast.words}: no partner of the test side was played; play that")
    return record.returns.select_partners(side)


def _values(returns: Returns, contrast: Contrast) -> np.ndarray:
    column, of_care = METRICS[contrast.metric], contrast.metric == "caring_success"
    if column not in returns.table.columns or (of_care and not measures_care(returns.table)):
        raise ValueError(
            f"{contrast.words}: tables of this task have no {contrast.metric}; name return"
        )
    return returns.column(column)


def named_pairs(
    file: ContrastsFile, methods: Sequence[tuple[str, str]]
) -> list[tuple[str, str, str]]:
    """Return task, method and baseline of the pairs to compare: the named ones, then the others.

    The others are all methods of a task beside each baseline of the file. Rows that know more than
    a method may, such as told robots, are not methods.
    """
    here = set(methods)
    baselines = {(task, c.baseline) for c in file.contrasts for task, _ in methods} & here
    pairs = {(c.task, c.method, c.baseline) for c in file.contrasts}
    pairs |= {(t, m, b) for t, b in baselines for task, m in methods if task == t and m != b}
    played = [(t, m, b) for t, m, b in sorted(pairs) if {(t, m), (t, b)} <= here]
    named = {(c.task, c.method, c.baseline) for c in file.contrasts}
    apart = {*FIRST, *LAST}
    return [p for p in played if p in named or not (p[:2] in baselines or p[1] in apart)]
