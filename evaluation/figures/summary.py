"""Figures of a study from its episode table, as dataclasses that `tables.to_json` converts."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl
from pydantic import TypeAdapter, ValidationError

from assistax_base.validated import first_problem
from assistax_envs.persons.rows import group_of, groups_of
from evaluation.cast.met_partners import MetSummary
from evaluation.figures.bootstrap import Draws, Estimate, Interval
from evaluation.figures.metrics import (
    CrossPlay,
    Fairness,
    Stability,
    Traits,
    ZeroShot,
    cross_play,
    cvar_crossfit,
    estimate_of,
    fairness,
    group_draws,
    rank_stability,
    same_teams,
    worst_partner,
    zero_shot,
)
from evaluation.figures.metrics.caring import CareFigures, care_figures
from evaluation.figures.metrics.generalisation import GROUPS
from evaluation.figures.metrics.installed import InstalledMetric, MetricFigure, metric_figures
from evaluation.figures.metrics.variance import Variance, variance_components
from evaluation.figures.normalised import References, Relative
from evaluation.figures.notes import (
    clipping_notes,
    episode_notes,
    group_notes,
    preference_notes,
    seed_notes,
    start_notes,
    team_notes,
    told_notes,
)
from evaluation.record import tables
from evaluation.record.columns import SIDES
from evaluation.record.record import Record, Returns
from evaluation.record.verification import check_whole
from zoo.partners.person_ids import OWN


@dataclasses.dataclass(frozen=True)
class SplitName:
    """The split of the partners' sides."""

    id: str
    sha256: str
    preferences: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)  # by side
    # Of the test side, if teams stand beside its persons: each has to play for M_test.
    groups: tuple[str, ...] = dataclasses.field(default=(), metadata={tables.OPTIONAL: True})


@dataclasses.dataclass(frozen=True, kw_only=True)
class Context:
    """Metadata of a run that is not in its episode table."""

    task: str
    env_version: int
    backend: str
    engine: dict[str, str] = dataclasses.field(default_factory=dict)  # its name and version
    release: str | None = None  # of the partners
    split: SplitName | None = None
    lock: str | None = None  # sha256 of the lock file that narrowed the registry down
    env_steps_per_second: float | None = None  # None if nothing had to be simulated


@dataclasses.dataclass(frozen=True, kw_only=True)
class Summary(Context):
    """Figures of every study."""

    episodes: int
    episodes_per_pair: int
    # Whether all partners played the same starts, as in older folders.
    common_starts: bool = True
    nonfinite: int  # episodes whose physics became non-finite; they count
    variance: Variance | None = None  # None with fewer than two robots or partners
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class NamedWorst:
    """The partner with the lowest mean return, see `evaluation.figures.metrics.WorstPartner`."""

    partner: str
    algorithm: str
    disability: str
    mean: float
    crossfit: float | None


@dataclasses.dataclass(frozen=True, kw_only=True)
class MoreFigures:
    """Figures that installed packages add, by name; none unless they were asked for."""

    more: dict[str, MetricFigure] = dataclasses.field(
        default_factory=dict, metadata={tables.OPTIONAL: True}
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class SideFigures(MoreFigures, CareFigures):
    """Figures of the partners of `side`: of those that played, test, validation or training."""

    side: Literal["train", "validation", "test"]
    by_algorithm: dict[str, Estimate]
    by_disability: dict[str, Estimate]
    fairness: Fairness | None  # None with a single disability setting
    # Only for gentle tasks: return by preference.
    by_preference: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    preference_fairness: Fairness | None = None  # None with fewer than two preferences
    # Of series of episodes, in which a robot remembers its partner: by place, from "1".
    by_place: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    # Measures of contact with the person by column of the table, if the task's version has them.
    touch: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    worst_partner: NamedWorst
    cvar_10: Interval | None  # None with one episode a pair


@dataclasses.dataclass(frozen=True, kw_only=True)
class EvaluationSummary(SideFigures, Summary, ZeroShot):
    """M_test, M_train, their gap, and the figures of the evaluated side."""

    egos: tuple[str, ...]
    partners: dict[str, int]  # how many are counted, by side
    references: References | None = None  # None if no reference egos were played
    relative: Relative | None = None
    met: MetSummary | None = None  # None for older folders without this record


@dataclasses.dataclass(frozen=True)
class BestEgo:
    """The robot with the highest mean return over all partners."""

    ego: str
    mean: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class MatrixFigures(MoreFigures):
    """Figures of the robots of a matrix."""

    best_ego: BestEgo
    rank_stability: Stability | None  # None if they have no ranking


@dataclasses.dataclass(frozen=True, kw_only=True)
class CrossPlaySummary(MatrixFigures, Summary, CrossPlay):
    """Self-play, cross-play and their gaps, resampling whole teams."""

    egos: int
    partners: int


def read_summary(folder: Path) -> EvaluationSummary | CrossPlaySummary:
    """Return the summary of an untrusted folder, with every field checked.

    Raises:
        FileNotFoundError: The folder has no summary, or is not finished.
        ValueError: A file is damaged, or the summary is neither an evaluation's nor a cross-play's.
    """
    check_whole(folder)
    content = tables.read_json(folder / tables.SUMMARY_FILE)
    kind = EvaluationSummary if "m_test" in content else CrossPlaySummary
    if kind is CrossPlaySummary and "cross_play" not in content:
        raise ValueError(
            f"{folder} holds neither an evaluation nor a cross-play; give a folder that one filled"
        )
    try:
        return TypeAdapter(kind).validate_python(content)
    except ValidationError as error:
        raise ValueError(
            f"{folder / tables.SUMMARY_FILE} is damaged, or of another version: "
            f"{first_problem(error)}; run again"
        ) from None


def summarise_evaluation(
    record: Record, context: Context, metrics: Mapping[str, InstalledMetric] | None = None
) -> EvaluationSummary:
    """Return the summary of an evaluation, whose egos are all seeds of one method.

    Args:
        record: The counted episodes.
        context: What they do not say of themselves.
        metrics: Metrics of installed packages by name.

    Raises:
        ValueError: The table is malformed or incomplete, or no partner is on a side of the split.
    """
    returns, side = record.returns, record.returns.evaluated_side
    sides = returns.partners["side"].to_list()
    algorithms = returns.partners["partner_algorithm"].to_list()
    expected = context.split.groups if context.split else ()
    groups = tuple(map(group_of, algorithms)) if expected else groups_of(algorithms)
    starts = {"common_starts": returns.common_starts}
    by_algorithm, by_disability = (
        group_draws(side.values, side.partners[f"partner_{trait}"].to_list(), **starts)
        for trait in ("algorithm", "disability")
    )
    by_preference = _preference_draws(side)
    several = side.values.shape[2] > 1
    return EvaluationSummary(
        **vars(zero_shot(returns.values, sides, groups, expected or GROUPS, **starts)),
        **_common(returns, context),
        side=side.partners["side"][0],
        variance=variance_components(side.values),
        by_algorithm=_estimates(by_algorithm),
        by_disability=_estimates(by_disability),
        fairness=fairness(by_disability) if len(by_disability) > 1 else None,
        by_preference=_estimates(by_preference),
        preference_fairness=fairness(by_preference) if len(by_preference) > 1 else None,
        by_place=_by_place(record.table, side),
        **vars(care_figures(side)),
        touch={
            name: estimate_of(values, side.groups, **starts) for name, values in side.touch.items()
        },
        worst_partner=_worst_partner(side),
        cvar_10=cvar_crossfit(side.values, 0.1, **starts) if several else None,
        more=metric_figures(metrics or {}, side, side.groups),
        egos=tuple(returns.egos["ego"]),
        partners={side: sides.count(side) for side in SIDES if side in {*sides, "train", "test"}},
        notes=(
            *seed_notes(returns.egos.height),
            *group_notes(side),
            *preference_notes(returns, context.split.preferences if context.split else {}),
            *start_notes(returns),
            *told_notes(context.engine),
            *episode_notes(returns),
            *clipping_notes(record.table),
        ),
    )


def summarise_crossplay(
    record: Record, context: Context, metrics: Mapping[str, InstalledMetric] | None = None
) -> CrossPlaySummary:
    """Return the summary of a matrix of egos by partners, with metrics of installed packages."""
    returns = record.returns
    rows, columns = _traits(returns.egos, "ego"), _traits(returns.partners, "partner")
    figures = cross_play(returns.values, rows, columns, common_starts=returns.common_starts)
    means = returns.scores.mean(axis=1)
    ranked = min(returns.scores.shape) > 1 and np.ptp(means) > 0
    return CrossPlaySummary(
        **vars(figures),
        **_common(returns, context),
        variance=variance_components(returns.values, ~same_teams(rows, columns)),
        best_ego=BestEgo(returns.egos["ego"][int(means.argmax())], float(means.max())),
        rank_stability=rank_stability(returns.scores) if ranked else None,
        more=metric_figures(metrics or {}, returns),
        egos=returns.egos.height,
        partners=returns.partners.height,
        notes=(*team_notes(returns), *episode_notes(returns)),
    )


def _common(returns: Returns, context: Context) -> dict:
    return {
        **vars(context),
        "episodes": returns.values.size,
        "episodes_per_pair": returns.values.shape[2],
        "common_starts": returns.common_starts,
        "nonfinite": int(returns.nonfinite.sum()),
    }


def _preference_draws(returns: Returns) -> dict[str, Draws]:
    """Return mean and IQM with replicates under each preference, over its partners, by name.

    Partners that bring their own are left out.
    """
    if returns.preferences is None:
        return {}
    scores, names = [], []
    for partner in range(returns.partners.height):
        played, values = returns.preferences[0, partner], returns.values[:, partner]
        for name in sorted({*played} - {OWN}):
            scores.append(values[:, played == name].mean(axis=1))
            names.append(name)
    return group_draws(np.stack(scores, axis=1), names)


def _by_place(table: pl.DataFrame, returns: Returns) -> dict[str, Estimate]:
    """Return the estimate of the return at each place of a series, over pairs, by place."""
    if "place" not in table.columns:
        return {}
    pairs = ["place", "ego", "partner"]
    played = table.filter(pl.col("partner").is_in(returns.partners["partner"].to_list()))
    means = played.group_by(pairs).agg(pl.col("return").cast(pl.Float64).mean()).sort(pairs)
    scores = means["return"].to_numpy().reshape(-1, *returns.scores.shape)
    return {str(place): estimate_of(score, returns.groups) for place, score in enumerate(scores, 1)}


def _estimates(draws: dict[str, Draws]) -> dict[str, Estimate]:
    return {name: draw.estimate() for name, draw in draws.items()}


def _traits(policies: pl.DataFrame, seat: str) -> Traits:
    return Traits(
        *(policies[f"{seat}_{name}"].to_list() for name in ("team", "algorithm", "disability"))
    )


def _worst_partner(returns: Returns) -> NamedWorst:
    worst = worst_partner(returns.values)
    named = returns.partners.row(worst.index, named=True)
    traits = (named[name] for name in ("partner", "partner_algorithm", "partner_disability"))
    return NamedWorst(*traits, worst.mean, worst.crossfit)
