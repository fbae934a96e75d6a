"""Both studies as the Python interface plays them: choose, cast, play."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from evaluation import crossplay
from evaluation.cast.cast import choose_partners
from evaluation.evaluate import cast_robots, evaluate
from evaluation.figures.summary import CrossPlaySummary, EvaluationSummary
from evaluation.play.how import PlaySettings
from zoo.registry import Registry

Globs = str | Sequence[str]


def evaluate_policies(
    registry: Registry,
    robots: Sequence[Any],
    how: PlaySettings,
    folder: Path,
    *,
    split: str | None = None,
    partners: Globs | None = None,
    trained_with: Globs | None = None,
    references: Path | None = None,
    **options: Any,
) -> EvaluationSummary:
    chosen = choose_partners(registry, how.task, split, partners)
    choices: dict[str, Any] = {"trained_with": trained_with, "baselines": references is not None}
    cast = cast_robots(registry, robots, chosen, **choices)
    return evaluate(cast, how, folder, references=references, **options)


def cross_play(
    registry: Registry,
    robots: Globs,
    humans: Globs,
    how: PlaySettings,
    folder: Path,
    **options: Any,
) -> CrossPlaySummary:
    cast = crossplay.cast_population(registry, how.task, robots, humans)
    return crossplay.cross_play(cast, how, folder, **options)
