"""Self-play, cross-play and the gaps between them, from a matrix of robots by humans."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Num

from assistax_base.statistics import returns_of
from evaluation.figures.bootstrap import (
    NOTHING,
    RESAMPLES,
    Counts,
    Draws,
    Estimate,
    Interval,
    draw_counts,
    draw_starts,
    interval,
    replicate,
    replicate_crossed,
)


@dataclasses.dataclass(frozen=True)
class Traits:
    """Traits of the policies along one axis of the matrix; None if unknown."""

    teams: Sequence[str | None]
    algorithms: Sequence[str | None]
    disabilities: Sequence[str | None]


@dataclasses.dataclass(frozen=True)
class CrossPlay:
    """Figures of a cross-play matrix; None if the matrix has no such pair."""

    self_play: Estimate | None
    cross_play: Estimate | None
    gap: Estimate | None  # self-play - cross-play
    # Gap of the means / mean self-play; None unless self-play is positive.
    relative_gap: Interval | None
    within_algorithm: Estimate | None
    across_algorithms: Estimate | None
    within_disability: Estimate | None
    across_disabilities: Estimate | None


def cross_play(
    scores: Num[np.ndarray, "R C K"] | Num[np.ndarray, "R C"],
    rows: Traits,
    columns: Traits,
    *,
    common_starts: bool = False,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> CrossPlay:
    """Return SP = mean_a X[a, a], XP = mean_{a != b} X[a, b] of X [R, C], with team intervals.

    A team on both axes is resampled as one unit, its robot with its human. A pair of a team with
    itself is self-play, however often the team is drawn, and never enters XP.

    Args:
        scores: Returns [R, C, K], or their means X [R, C].
        rows: The robots.
        columns: The humans.
        common_starts: Whether all humans played the same K starts.
        resamples: Number of resamples.
        seed: Seed of the resamples.
    """
    scores, rng = returns_of(scores), np.random.default_rng(seed)
    row_counts, column_counts = _team_counts(rows.teams, columns.teams, resamples, rng)
    starts = draw_starts(scores.shape, common_starts, resamples, rng)
    to = _generalises_to(rows.teams, columns.teams, starts is not None)
    counts = Counts(row_counts, column_counts, starts, to)
    own = same_teams(rows, columns)
    same_algorithm = _equal(rows.algorithms, columns.algorithms)
    same_disability = _equal(rows.disabilities, columns.disabilities)
    known_algorithm = _known(rows.algorithms, columns.algorithms)
    known_disability = _known(rows.disabilities, columns.disabilities)

    def apart(mask: np.ndarray) -> Draws | None:
        cells = ~own & mask
        return replicate_crossed(scores, counts, cells) if cells.any() else None

    sp, xp = _self_play(scores, own, counts), apart(~own)
    draws = {
        "self_play": sp,
        "cross_play": xp,
        "gap": sp - xp if sp and xp else None,
        "within_algorithm": apart(same_algorithm),
        "across_algorithms": apart(known_algorithm & ~same_algorithm),
        "within_disability": apart(same_disability),
        "across_disabilities": apart(known_disability & ~same_disability),
    }
    return CrossPlay(
        relative_gap=_relative(sp, xp) if sp and xp else None,
        **{name: draw.estimate() if draw else None for name, draw in draws.items()},
    )


def same_teams(rows: Traits, columns: Traits) -> Bool[np.ndarray, "R C"]:
    """Return a mask [R, C] of the robots and humans that were trained together."""
    return _equal(rows.teams, columns.teams)


def _self_play(scores: np.ndarray, own: np.ndarray, counts: Counts) -> Draws | None:
    """Return self-play with replicates; a team drawn twice counts twice, not four times."""
    rows, columns = np.nonzero(own)
    if not rows.size:
        return None
    values = scores[rows, columns]
    return replicate(values, counts.seeds[:, rows], counts.generalises_to, counts.starts)


def _relative(sp: Draws, xp: Draws) -> Interval | None:
    if sp.mean <= 0:
        return None
    ratios = np.divide(
        sp.means - xp.means, sp.means, out=np.full(len(sp.means), np.nan), where=sp.means > 0
    )
    return Interval(
        1 - xp.mean / sp.mean, interval(ratios, xp.generalises_to), sp.n + xp.n, xp.generalises_to
    )


def _team_counts(
    rows: Sequence[str | None],
    columns: Sequence[str | None],
    resamples: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Return random counts of rows [B, R] and columns [B, C].

    Teams on both axes are drawn together, the others on their own axis.
    """
    shared = sorted(_shared(rows, columns))
    shared_counts = draw_counts(len(shared), resamples, rng) if shared else None
    counts = []
    for teams in (rows, columns):
        alone = [i for i, team in enumerate(teams) if team not in shared]
        axis = np.ones((resamples, len(teams)), np.int64)
        if alone:
            axis[:, alone] = draw_counts(len(alone), resamples, rng)
        for i, team in enumerate(teams):
            if shared_counts is not None and team in shared:
                axis[:, i] = shared_counts[:, shared.index(team)]
        counts.append(axis)
    return counts[0], counts[1]


def _generalises_to(rows: Sequence[str | None], columns: Sequence[str | None], starts: bool) -> str:
    if len(_shared(rows, columns)) > 1:
        names = ["teams"]
    else:
        axes = (("egos", rows), ("partners", columns))
        names = [name for name, axis in axes if len(axis) > 1]
    return " and ".join([*names, "starts"] if starts else names) or NOTHING


def _shared(rows: Sequence[str | None], columns: Sequence[str | None]) -> set[str]:
    return {team for team in rows if team is not None and team in columns}


def _known(rows: Sequence[str | None], columns: Sequence[str | None]) -> np.ndarray:
    return np.logical_and.outer(
        [value is not None for value in rows], [value is not None for value in columns]
    )


def _equal(rows: Sequence[str | None], columns: Sequence[str | None]) -> np.ndarray:
    return _known(rows, columns) & (
        np.array(rows, object)[:, None] == np.array(columns, object)[None, :]
    )
