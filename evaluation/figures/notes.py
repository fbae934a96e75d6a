"""What a reader has to know of figures: how few they are of, and what they leave out."""

from collections import Counter
from collections.abc import Mapping, Sequence

import polars as pl

from assistax_base.errors import counted
from evaluation.record.record import Returns

# Seeds, partners or teams; with fewer, intervals cover too little (see
# `evaluation.figures.bootstrap.estimate`).
ENOUGH = 16


def seed_notes(egos: int) -> list[str]:
    """Say how few seeds an interval is of."""
    if egos == 1:
        return ["one ego: intervals speak about new partners, not about new training seeds"]
    return _few(egos, f"{egos} seeds", " seeds")


def group_notes(returns: Returns) -> list[str]:
    """Say how few partners the smallest group has."""
    columns = ("partner_algorithm", "partner_disability")
    counts = [Counter(returns.partners[name]) for name in columns]
    smallest = min(count for groups in counts for count in groups.values())
    return _few(smallest, f"groups of partners have as few as {smallest}", " partners")


def preference_notes(returns: Returns, sides: Mapping[str, Sequence[str]]) -> list[str]:
    """Say which partners played under preferences that are not their side's of the split."""
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
    """Say how few teams a matrix is of."""
    units = min(returns.egos.height, returns.partners.height)
    return _few(units, counted(units, "team"))


def start_notes(returns: Returns) -> list[str]:
    """Say which intervals leave out the luck of starts that all partners have in common."""
    if not returns.common_starts:
        return []
    return [
        f"all partners played the same {returns.values.shape[2]} starts: intervals by preference, "
        "by place, of relative figures and of the profile leave their luck out"
    ]


def clipping_notes(table: pl.DataFrame) -> list[str]:
    """Say how much of what robots from outside did was beyond what there is."""
    if "clipped" not in table.columns or not (shares := table["clipped"].drop_nulls()).sum():
        return []
    return [
        f"actions went beyond [-1, 1] and were clipped in {(shares > 0).sum()} of {len(shares)} "
        f"episodes: {shares.to_numpy().mean():.1%} of their numbers"
    ]


def episode_notes(returns: Returns) -> list[str]:
    """Say which episodes broke, and whether egos met the same partners."""
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
