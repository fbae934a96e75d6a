"""The rows of a board: every method's figures, and the place they earn it."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from evaluation.figures.bootstrap import (
    RESAMPLES,
    Estimate,
    Interval,
    crossed_counts,
    estimate,
    interval,
)
from evaluation.figures.metrics import (
    Bounds,
    Fairness,
    cvar_crossfit,
    fairness,
    group_draws,
    mean_of_groups,
    normalised_return,
    rank_methods,
)

TAIL = 0.1  # share of partners in the lower tail


@dataclasses.dataclass(frozen=True)
class Panel:
    """The partners that every method of a board meets."""

    disabilities: tuple[str | None, ...]  # [P]
    bounds: Bounds | None = None  # of a random robot and of the best response; None if unknown
    groups: tuple[str, ...] | None = None  # [P] that count the same in M_test; None without groups
    seed_sd: float | None = None  # how far seeds of one method differ, see `rank_methods`
    unseen: int = 0  # entries with scores that have no place on this board, see `rank_methods`


@dataclasses.dataclass(frozen=True)
class Method:
    """One method's episodes on the panel."""

    name: str
    returns: np.ndarray  # [S, P, K]: its seeds, the panel's partners, the panel's episodes
    competes: bool = True  # False for a reference, a single robot, or an entry that is not whole


@dataclasses.dataclass(frozen=True)
class BoardRow:
    """One row of a board."""

    name: str
    place: int | None  # shared by methods that cannot be told apart; None if it does not compete
    lowest: int | None  # rank no lower than this, at 95% for the whole board
    m_test: Estimate
    worst_tenth: Interval  # one partner in ten earns less
    cvar: Interval | None  # mean of the lowest tenth of partners; None with one episode a pair
    fairness: Fairness | None  # None if no partner's disability is known
    normalised: Estimate | None  # 0 is a random robot, 1 the best response; None without bounds
    by_group: Mapping[str, Estimate] = dataclasses.field(default_factory=dict)  # see `Panel.groups`


def board_rows(
    methods: Sequence[Method],
    panel: Panel,
    figures: Callable[[Method, Panel], BoardRow] | None = None,
) -> tuple[BoardRow, ...]:
    """Return the board, the highest M_test first.

    Args:
        methods: what is ranked, and what it is measured by.
        panel: the partners that all of them met.
        figures: makes a method's row without its place; default `unplaced`.

    Raises:
        ValueError: there are no methods, or one has not played the whole panel.
    """
    _check(methods, panel)
    places = _rank_competitors(methods, panel)
    rows = [
        dataclasses.replace((figures or unplaced)(method, panel), place=place, lowest=lowest)
        for method in methods
        for place, lowest in [places.get(method.name, (None, None))]
    ]
    return tuple(sorted(rows, key=lambda row: (-row.m_test.mean, row.name)))


def _rank_competitors(methods: Sequence[Method], panel: Panel) -> dict[str, tuple[int, int]]:
    """Return place and worst rank of each competing method; empty for a single partner."""
    names = [method.name for method in methods if method.competes]
    if not names or methods[0].returns.shape[1] < 2:
        return {}
    scores = [method.returns.mean(axis=2) for method in methods if method.competes]
    ranks = rank_methods(scores, groups=panel.groups, seed_sd=panel.seed_sd, unseen=panel.unseen)
    places = zip(ranks.places.tolist(), ranks.lowest.tolist(), strict=True)
    return dict(zip(names, places, strict=True))


def unplaced(
    method: Method, panel: Panel, *, resamples: int = RESAMPLES, seed: int = 0
) -> BoardRow:
    """Return a method's row without its place: no other method has a part in it."""
    scores = method.returns.mean(axis=2)
    settings = group_draws(scores, panel.disabilities, resamples=resamples, seed=seed)
    m_test, by_group = estimate_of(scores, panel.groups, resamples, seed)
    has_halves = method.returns.shape[2] > 1
    return BoardRow(
        name=method.name,
        place=None,
        lowest=None,
        m_test=m_test,
        worst_tenth=worst_tenth(scores, resamples=resamples, seed=seed),
        cvar=cvar_crossfit(method.returns, TAIL, resamples=resamples, seed=seed)
        if has_halves
        else None,
        fairness=fairness(settings) if settings else None,
        normalised=_normalised(scores, panel, resamples, seed),
        by_group=by_group,
    )


def estimate_of(
    scores: np.ndarray,
    groups: Sequence[str] | None,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[Estimate, Mapping[str, Estimate]]:
    """Return the mean of scores [S, P], of groups the mean of their means, and each group's."""
    if groups is None:
        return estimate(scores, resamples=resamples, seed=seed), {}
    return mean_of_groups(scores, groups, resamples=resamples, seed=seed)


def worst_tenth(scores: np.ndarray, *, resamples: int = RESAMPLES, seed: int = 0) -> Interval:
    """Return that one partner in ten does not exceed: the 10% quantile over P of scores [S, P]."""
    seeds, partners = scores.shape
    counts = crossed_counts((seeds, partners), False, resamples, seed)
    replicates = _lower_quantile(counts.seeds @ scores / seeds, counts.partners)
    point = _lower_quantile(scores.mean(axis=0)[None], np.ones((1, partners), int))
    to = counts.generalises_to
    return Interval(float(point[0]), interval(replicates, to), seeds * partners, to)


def _lower_quantile(values: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """Smallest value [B] that a tenth of the entries [B, n] with their counts do not exceed."""
    order = np.argsort(values, axis=1, kind="stable")
    reached = np.cumsum(np.take_along_axis(counts, order, axis=1), axis=1, dtype=float)
    first = np.argmax(reached >= TAIL * reached[:, -1:], axis=1)
    return np.take_along_axis(values, order, axis=1)[np.arange(len(values)), first]


def _normalised(scores: np.ndarray, panel: Panel, resamples: int, seed: int) -> Estimate | None:
    bounds = panel.bounds
    if bounds is None or not bounds.scorable.any():
        return None
    shares = normalised_return(scores, bounds)[:, bounds.scorable]
    groups = panel.groups and [panel.groups[place] for place in np.flatnonzero(bounds.scorable)]
    return estimate_of(shares, groups, resamples, seed)[0]


def _check(methods: Sequence[Method], panel: Panel) -> None:
    if not methods:
        raise ValueError("there are no methods; a board needs one or more")
    expected = (len(panel.disabilities), methods[0].returns.shape[-1])
    for method in methods:
        if method.returns.ndim != 3 or method.returns.shape[1:] != expected:
            raise ValueError(
                f"{method.name} has returns of shape {method.returns.shape}; expected [seeds, "
                f"{expected[0]} partners, {expected[1]} episodes], as the others have"
            )
