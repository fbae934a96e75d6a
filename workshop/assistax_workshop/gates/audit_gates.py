"""Gates of an audit: figures of its conditions against their bars, with 95% intervals."""

import dataclasses
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Any

import numpy as np
import polars as pl

from assistax_envs.tasks.gentle_rules import HARD
from evaluation.figures.bootstrap import RESAMPLES, draw_counts
from evaluation.figures.metrics import Traits, cross_play
from evaluation.record.record import lay_out
from population.views import View

Ends = tuple[float, float] | None


class Condition(StrEnum):
    """Pairing of robots with humans; the text names its figures in an audit."""

    OWN = "own teams"
    PAIRS = "all pairs"
    STRANGERS = "strangers"
    SCRIPT = "script, passive human"
    HELD = "script, human held"
    ALONE = "own, passive human"
    PASSIVE = "passive robot, passive human"
    PASSIVE_TEAM = "passive robot, teams' humans"
    RESPONSE = "best responses"
    EGO = "ego"
    EGO_TOLD = "ego told"
    EGO_RECURRENT = "ego recurrent"
    RECURRENT = "recurrent"
    KNOWING = View.PREFERENCE.condition
    BLIND = "blind"
    MISTAKEN = "mistaken humans"
    TOUCH = "own, step by step"


@dataclasses.dataclass(frozen=True)
class Gate:
    """Figure of a task against its bar."""

    gate: str
    bar: str
    value: float | None  # None if it was not measured
    ci: Ends  # 95%, over robots, or over episodes of a single robot; None if there is one of either
    holds: bool | None  # None if it was not measured
    told: str  # details of the comparison, or the policies that it lacks


def gates_of(
    task: str,
    tables: Mapping[str, pl.DataFrame] | Mapping[Condition, pl.DataFrame],
    touch: Mapping[str, float],
) -> list[Gate]:
    """Return the gates of a task, from the episodes of each condition; see `audit_task`."""
    played = {Condition(name): table for name, table in tables.items()}  # refuses others
    pairs = played[Condition.PAIRS]
    own, goal = played[Condition.OWN], "success"
    reached = own.group_by("ego").agg(pl.col(goal).cast(pl.Float64).mean())
    half = float(reached[goal].to_numpy().max()) / 2

    def earned(
        name: str, bar: str, what: Condition, least: float, needs: str, paired: bool = False
    ) -> Gate:
        return _earned(name, bar, own, played.get(what), least, needs, paired=paired)

    def lost(
        name: str,
        bar: str,
        what: Condition,
        least: float,
        needs: str,
        *,
        above: bool = False,
        paired: bool = False,
    ) -> Gate:
        return _lost(earned(name, bar, what, least, needs, paired), least, above=above)

    return [
        _share("script with a passive human", f"{goal} < {half:.2f}, half of the best team's",
               played[Condition.SCRIPT], goal, lambda x: x < half),
        _share("script with the human in its best fixed posture", f"{goal} < {half:.2f}",
               _best_held(played[Condition.HELD]), goal, lambda x: x < half),
        lost("robot trained with a passive human", "with one it earns > 20% less than teams",
             Condition.PASSIVE, 0.2, "a passive robot"),
        lost("the same robot with the teams' humans", "loses > 20%",
             Condition.PASSIVE_TEAM, 0.2, "a passive robot"),
        _share("teams reach the goal", f"{goal} >= 0.80", own, goal, lambda x: x >= 0.8),
        _share("teams hurt nobody", "violations < 0.01", own, "violated", lambda x: x < 0.01),
        _cross_play(pairs),
        earned("best response to a frozen partner", ">= 80% of self-play", Condition.RESPONSE, 0.8,
               "a response to each team", paired=True),
        earned("teams whose robot is told the preference", "> 5% more", Condition.KNOWING, 1.05,
               "told teams"),
        earned("teams whose robot remembers", "more than those without memory", Condition.RECURRENT,
               1.0, "recurrent teams"),
        *_ego_gates(played),
        lost("humans that believe in another preference", "loses, the interval above 0",
             Condition.MISTAKEN, 0.0, "a gentle task", above=True, paired=True),
        lost("control: humans that were never told theirs", "loses, the interval above 0",
             Condition.BLIND, 0.0, "blind teams", above=True),
        *_touch_gates(touch),
    ]  # fmt: skip


def _ego_gates(played: Mapping[Condition, pl.DataFrame]) -> list[Gate]:
    """Return the gates of robots among strangers: worth of the preference, and of memory."""
    name, needs = (
        "among strangers, a robot that is told the preference",
        "egos, and egos that are told",
    )
    plain, knowing, recurrent = map(
        played.get, (Condition.EGO, Condition.EGO_TOLD, Condition.EGO_RECURRENT)
    )
    if plain is None or knowing is None:
        return [Gate(name, "> 5% more", None, None, None, f"not measured: needs {needs}")]
    worth = _earned(name, "> 5% more", plain, knowing, 1.05, needs, than="not told")
    name, bar = "share of that which a recurrent robot wins back", "the interval above 0"
    if recurrent is None:
        return [worth, Gate(name, bar, None, None, None, "not measured: needs recurrent egos")]
    returns = [_by_robot(table, "return") for table in (plain, knowing, recurrent)]
    detail = f"return {returns[2].mean():.1f}"
    if returns[1].mean() <= returns[0].mean():
        return [worth, Gate(name, bar, None, None, None, f"{detail}: nothing to win back")]
    value, ci = of_means(lambda a, b, c: (c - a) / (b - a), *returns)
    return [worth, Gate(name, bar, value, ci, ci is not None and ci[0] > 0.0, detail)]


def strange_pairs(table: pl.DataFrame) -> pl.DataFrame:
    """Return the episodes of robots with other teams' humans."""
    return table.filter(pl.col("ego_team") != pl.col("partner_team"))


def condition_figures(table: pl.DataFrame) -> dict[str, float]:
    """Return the means of a condition's episodes by name."""
    names = ("return", "success", "discomfort_share", "violated", "force_mean", "force_peak")
    present = [name for name in (*names, "contact_peak") if name in table.columns]
    means = table.select(pl.col(name).cast(pl.Float64).mean() for name in present)
    return {"episodes": float(table.height), **means.row(0, named=True)}


def _touch_gates(touch: Mapping[str, float]) -> list[Gate]:
    """Return the gates of contact forces and joint speeds."""
    below = touch.get("contact steps below the limit")
    speed = touch["joint speed, share of the limit"]
    detail = "own teams, step by step"
    return [
        Gate(f"contact steps below {HARD:g} N", ">= 0.99", below, None,
             None if below is None else below >= 0.99, detail if below else "nobody was touched"),
        Gate("fastest joint, share of the datasheet's", "<= 1", speed, None, speed <= 1.0, detail),
    ]  # fmt: skip


def _share(
    name: str, bar: str, table: pl.DataFrame, column: str, holds: Callable[[float], bool]
) -> Gate:
    """Return the gate of a share of episodes, the mean of a column."""
    if column not in table.columns:
        return Gate(name, bar, None, None, None, "not measured: a gentle task's sensors feel it")
    values = _by_robot(table, column)
    value, ci = of_means(lambda mean: mean, values)
    return Gate(name, bar, value, ci, holds(value), f"return {table['return'].mean():.1f}")


def _cross_play(table: pl.DataFrame) -> Gate:
    """Return the gate of the share of self-play's return that strangers lose, by team bootstrap."""
    name, bar = "cross-play between seeds", "loses > 10%, the interval above 0"
    if strange_pairs(table).is_empty():
        return Gate(name, bar, None, None, None, "not measured: needs two teams")
    returns = lay_out(table)
    seats = ((returns.egos, "ego"), (returns.partners, "partner"))
    traits = [
        Traits(*(who[f"{seat}_{t}"].to_list() for t in ("team", "algorithm", "disability")))
        for who, seat in seats
    ]
    result = cross_play(returns.values, *traits, common_starts=returns.common_starts)
    gap, own, strange = result.relative_gap, result.self_play, result.cross_play
    detail = f"return {strange.mean:.1f}, own teams {own.mean:.1f}" if own and strange else ""
    if gap is None:
        return Gate(name, bar, None, None, None, f"{detail}: no share of it")
    holds = gap.value > 0.1 and gap.value_ci is not None and gap.value_ci[0] > 0.0
    return Gate(name, bar, gap.value, gap.value_ci, holds, detail)


def _lost(gate: Gate, least: float, *, above: bool = False) -> Gate:
    """Return the gate of the share that a condition loses, from the gate of its earned share."""
    if gate.value is None:
        return gate
    value, ci = 1.0 - gate.value, (1.0 - gate.ci[1], 1.0 - gate.ci[0]) if gate.ci else None
    holds = value > least and (not above or (ci is not None and ci[0] > 0.0))
    return dataclasses.replace(gate, value=value, ci=ci, holds=holds)


def _earned(
    name: str,
    bar: str,
    own: pl.DataFrame,
    other: pl.DataFrame | None,
    least: float,
    needs: str,
    *,
    paired: bool = False,
    than: str = "own teams",
) -> Gate:
    """Return the gate of another condition's return, as a share of the return of `than`.

    With `paired`, only episodes with the same humans are compared; own teams may have more.
    """
    if other is None:
        return Gate(name, bar, None, None, None, f"not measured: needs {needs}")
    who = "ego"
    if paired:
        own, who = own.join(other, on=("partner", "episode"), how="semi"), "partner"
    ours, theirs = _by_robot(own, "return", who), _by_robot(other, "return", who)
    detail = f"return {theirs.mean():.1f}, {than} {ours.mean():.1f}"
    if ours.mean() <= 0.0:
        return Gate(name, bar, None, None, None, f"{detail}: no share of it")
    value, ci = of_means(lambda a, b: b / a, ours, theirs, paired=paired)
    return Gate(name, bar, value, ci, value >= least, detail)


def of_means(
    figure: Callable[..., Any], *samples: np.ndarray, paired: bool = False
) -> tuple[float, Ends]:
    """Return a figure of the samples' means and its interval.

    Paired samples are resampled together.
    """
    point = float(figure(*(values.mean() for values in samples)))
    if min(values.size for values in samples) < 2:
        return point, None
    rng = np.random.default_rng(0)
    counts = [draw_counts(values.size, RESAMPLES, rng) for values in samples]
    counts = counts[:1] * len(samples) if paired else counts
    means = [drawn @ v / v.size for drawn, v in zip(counts, samples, strict=True)]
    low, high = np.quantile(figure(*means), (0.025, 0.975))
    return point, (float(low), float(high))


def _by_robot(table: pl.DataFrame, column: str, who: str = "ego") -> np.ndarray:
    """Return the means of a column by robot, or its episodes if one robot played.

    With `who` "partner", of each human: those who meet one robot each stand for it, by one name in
    all conditions.
    """
    table = table.with_columns(pl.col(column).cast(pl.Float64))
    if table["ego"].n_unique() == 1:
        return table.sort("partner", "episode")[column].to_numpy()
    return table.group_by(who).agg(pl.col(column).mean()).sort(who)[column].to_numpy()


def _best_held(table: pl.DataFrame) -> pl.DataFrame:
    """Return the odd episodes with the human that is best in the even ones.

    The best of many is good by chance too: half of the episodes choose it, the other half value it.
    """
    even = pl.col("episode") % 2 == 0
    means = table.filter(even).group_by("partner").agg(pl.col("return").mean())
    best = means.sort("return", "partner", descending=[True, False])["partner"][0]
    return table.filter((pl.col("partner") == best) & ~even)
