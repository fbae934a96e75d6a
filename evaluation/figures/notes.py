"""Notes for readers of figures: small samples, and what the figures leave out."""

from collections import Counter
from collections.abc import Mapping, Sequence

import polars as pl

from assistax_base.errors import counted
from evaluation.record.record import Returns
from population.views import CONDITION, View

# Seeds, partners or teams; with fewer, intervals cover too little (see
# `evaluation.figures.bootstrap.estimate`).
ENOUGH = 16


def seed_notes(egos: int) -> list[str]:
    """Return a note if intervals are of few seeds."""
    if egos == 1:
        return ["one robot: intervals speak about new partners, not about new training seeds"]
    return _few(egos, f"{egos} seeds", " seeds")


def group_notes(returns: Returns) -> list[str]:
    """Return a note if the smallest group of partners is small."""
    columns = ("partner_algorithm", "partner_disability")
    counts = [Counter(returns.partners[name]) for name in columns]
    smallest = min(count for groups in counts for count in groups.values())
    return _few(smallest, f"groups of partners have as few as {smallest}", " partners")


def preference_notes(returns: Returns, sides: Mapping[str, Sequence[str]]) -> list[str]:
    """Return notes on partners that played under preferences of another side of the split."""
    if returns.preferences is None:
        return []
    notes = []
    for side, names in sides.items():
        mask = (returns.partners["side"] == side).fill_null(value=False).to_numpy()
        if others := sorted(set(returns.preferences[:, mask].ravel()) - set(names)):
            notes.append(
                f"{side} partners played under {', '.join(others)}; the split's {side} preferences "
                f"are {', '.join(names)}"
            )
    return notes


def team_notes(returns: Returns) -> list[str]:
    """Return a note if a matrix is of few teams."""
    units = min(returns.egos.height, returns.partners.height)
    return _few(units, counted(units, "team"))


def start_notes(returns: Returns) -> list[str]:
    """Return a note on intervals without the variance of starts common to all partners."""
    if not returns.common_starts:
        return []
    return [
        f"all partners played the same {returns.values.shape[2]} starts: intervals by preference, "
        "by place, of relative figures and of the profile leave their luck out"
    ]


def clipping_notes(table: pl.DataFrame) -> list[str]:
    """Return notes on actions of robots from outside that were clipped to [-1, 1]."""
    if "clipped" not in table.columns or not (shares := table["clipped"].drop_nulls()).sum():
        return []
    return [
        f"actions went beyond [-1, 1] and were clipped in {(shares > 0).sum()} of {len(shares)} "
        f"episodes: {shares.to_numpy().mean():.1%} of their numbers"
    ]


def told_notes(engine: Mapping[str, str]) -> list[str]:
    """Return a note on robots that are told all numbers of a person."""
    if engine.get(CONDITION) != View.NUMBERS.condition:
        return []
    return [
        "robots are told all numbers of a person, which teams do not have: figures are of persons "
        "alone"
    ]


def episode_notes(returns: Returns) -> list[str]:
    """Return notes on non-finite episodes, and on egos that played different episodes."""
    broken = int(returns.nonfinite.sum())
    notes = []
    if broken:
        notes.append(
            f"{broken} of {returns.values.size} episodes became non-finite and earn 0 from then "
            "on; they count"
        )
    if returns.keys is None:
        notes.append("egos played different episodes: their differences are not paired")
    return notes


def _few(count: int, what: str, of: str = "") -> list[str]:
    return [f"{what}: intervals over fewer than {ENOUGH}{of} are too narrow"] * (count < ENOUGH)
