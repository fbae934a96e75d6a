"""Metrics over partners: M_test, M_train and their gap, figures by group, the lower tail."""

import dataclasses
from collections import Counter
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Num

from assistax_base.statistics import returns_of, tail_weights
from assistax_envs.persons.rows import KNOWN_FAMILIES, UNSEEN_FAMILY
from evaluation.figures.bootstrap import (
    RESAMPLES,
    Counts,
    Draws,
    Estimate,
    Interval,
    crossed_counts,
    draw_counts,
    draw_starts,
    estimate,
    generalises_to,
    interval,
    replicate_crossed,
)

G = TypeVar("G", str, tuple[str, str])

GROUPS = (KNOWN_FAMILIES, UNSEEN_FAMILY)  # of a test side that has groups


@dataclasses.dataclass(frozen=True)
class ZeroShot:
    """M over the partners of each side; None for a side that was not evaluated."""

    m_test: Estimate | None
    m_train: Estimate | None
    gap: Estimate | None  # m_train - m_test, the same resampled seeds on both sides
    m_validation: Estimate | None = None
    by_group: dict[str, Estimate] = dataclasses.field(default_factory=dict)  # of the test side


@dataclasses.dataclass(frozen=True)
class Fairness:
    """Spread of M over groups of partners, by the mean."""

    worst: str  # group with the lowest mean
    best: str
    gap: Interval  # highest minus lowest mean; noise alone makes it positive


@dataclasses.dataclass(frozen=True)
class WorstPartner:
    """The partner with the lowest mean return."""

    index: int  # along the axis of partners
    mean: float  # over seeds and episodes; the minimum of noisy means is too low
    # Chosen on even episodes and valued on odd ones, and the reverse; None with one episode.
    crossfit: float | None


def zero_shot(
    scores: np.ndarray,
    sides: Sequence[str | None],
    groups: Sequence[str] | None = None,
    expected: Sequence[str] = GROUPS,
    *,
    common_starts: bool = False,
) -> ZeroShot:
    """Return M(s) = mean over partners p of J[s, p], separately for the partners of each side.

    If the test side has groups, M_test is the mean of the groups' means: each group counts the
    same. It is None if one of those expected did not play, so that a robot that suits one group
    alone cannot hide.

    Args:
        scores: Returns [S, P, K], or mean returns J [S, P].
        sides: "test", "validation", "train" or None (on no side) for each partner [P].
        groups: The group of each partner [P]; None if the test side has no groups.
        expected: The groups that the test side has.
        common_starts: Whether all partners played the same K starts.
    """
    in_groups = groups or [""] * len(sides)
    labels = [
        (side, group if side == "test" else "") if side else None
        for side, group in zip(sides, in_groups, strict=True)
    ]
    draws = group_draws(scores, labels, common_starts=common_starts)
    tested = {group: found for (side, group), found in draws.items() if side == "test"}
    validation, train = (draws.get((side, "")) for side in ("validation", "train"))
    if not (tested or validation or train):
        raise ValueError("no partner is on a side; evaluate against a split")
    whole = bool(tested) and (groups is None or tested.keys() >= set(expected))
    test = mean_of_draws(tuple(tested.values())) if whole else None
    gap = train - test if train and test else None
    figures = (test, train, gap, validation)
    by_group = {group: found.estimate() for group, found in tested.items() if group}
    return ZeroShot(*(found.estimate() if found else None for found in figures), by_group)


def mean_of_groups(
    scores: np.ndarray,
    groups: Sequence[str],
    *,
    common_starts: bool = False,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> tuple[Estimate, dict[str, Estimate]]:
    """Return the mean of the groups' means, in which each group counts the same, and each group.

    Args:
        scores: Returns [S, P, K], or mean returns [S, P].
        groups: The group of each partner [P].
        common_starts: Whether all partners played the same K starts.
        resamples: Number of resamples; partners are resampled within each group.
        seed: Seed of the resamples.
    """
    how: dict[str, Any] = {"common_starts": common_starts, "resamples": resamples, "seed": seed}
    draws = group_draws(scores, groups, **how)
    by_group = {group: found.estimate() for group, found in draws.items()}
    return mean_of_draws(tuple(draws.values())).estimate(), by_group


def estimate_of(
    scores: np.ndarray, groups: Sequence[str] | None, *, common_starts: bool = False
) -> Estimate:
    """Return the mean over seeds and partners; with groups, the mean of the groups' means.

    Args:
        scores: Values [S, P, K] or [S, P].
        groups: The group of each partner [P], if each group counts the same.
        common_starts: Whether all partners played the same K starts.
    """
    if groups is None:
        return estimate(scores, common_starts=common_starts)
    return mean_of_groups(scores, groups, common_starts=common_starts)[0]


def group_weights(groups: Sequence[str]) -> np.ndarray:
    """Return weights [P] of mean 1: the mean of weighted scores is the mean of the groups' means.

    Args:
        groups: The group of each partner [P].
    """
    sizes = Counter(groups)
    return np.array([len(groups) / (len(sizes) * sizes[group]) for group in groups])


def group_draws(
    scores: np.ndarray,
    groups: Sequence[G | None],
    *,
    common_starts: bool = False,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> dict[G, Draws]:
    """Return mean and IQM with replicates for each group of partners, sorted by name.

    Seeds are resampled once for all groups, and so are starts that all partners have in common.
    Partners are resampled within each group. So groups subtract to paired differences. Partners of
    group None are left out.

    Args:
        scores: Returns [S, P, K], or mean returns [S, P].
        groups: The group of each partner.
        common_starts: Whether all partners played the same K starts.
        resamples: Number of resamples.
        seed: Seed of the resamples.
    """
    scores = returns_of(scores)
    if len(groups) != scores.shape[1]:
        raise ValueError(
            f"there are {len(groups)} groups for {scores.shape[1]} partners; give one for each "
            "partner"
        )
    rng = np.random.default_rng(seed)
    seed_counts = draw_counts(len(scores), resamples, rng)
    members = {
        name: np.array([group == name for group in groups])
        for name in sorted({name for name in groups if name is not None})
    }
    partner_counts = {
        name: draw_counts(int(mask.sum()), resamples, rng) for name, mask in members.items()
    }
    shared = draw_starts(scores.shape, True, resamples, rng) if common_starts else None
    draws = {}
    for name, mask in members.items():
        part = scores[:, mask]
        starts = shared
        if not common_starts:
            starts = draw_starts(part.shape, False, resamples, rng)
        units = 1 if starts is None else starts.shape[1]
        to = generalises_to(*part.shape[:2], units)
        counts = Counts(seed_counts, partner_counts[name], starts, to)
        draws[name] = replicate_crossed(part, counts)
    return draws


def mean_of_draws(groups: Sequence[Draws]) -> Draws:
    """Return the mean of groups' figures, each of which counts the same whatever its size."""
    return Draws(
        mean=float(np.mean([group.mean for group in groups])),
        iqm=float(np.mean([group.iqm for group in groups])),
        means=np.mean([group.means for group in groups], axis=0),
        iqms=np.mean([group.iqms for group in groups], axis=0),
        n=sum(group.n for group in groups),
        generalises_to=max((group.generalises_to for group in groups), key=len),
    )


def fairness(draws: dict[str, Draws]) -> Fairness:
    """Return the worst group and the gap of the groups' means.

    The gap is max_g M_g - min_g M_g, computed in every draw for its interval.
    """
    means = {name: draw.mean for name, draw in draws.items()}
    worst, best = min(means, key=means.__getitem__), max(means, key=means.__getitem__)
    replicates = np.stack([draw.means for draw in draws.values()])
    to = max((draw.generalises_to for draw in draws.values()), key=len)
    n = sum(draw.n for draw in draws.values())
    ci = interval(replicates.max(axis=0) - replicates.min(axis=0), to) if len(draws) > 1 else None
    return Fairness(worst, best, Interval(means[best] - means[worst], ci, n, to))


def worst_partner(returns: Num[np.ndarray, "S P K"]) -> WorstPartner:
    """Return the partner with the lowest mean over seeds and episodes."""
    means = returns.mean(axis=(0, 2))
    crossfit = None
    if returns.shape[2] > 1:
        even, odd = (half.mean(axis=0) for half in _halves(returns))
        crossfit = float((odd[even.argmin()] + even[odd.argmin()]) / 2)
    return WorstPartner(int(means.argmin()), float(means.min()), crossfit)


def cvar_crossfit(
    returns: Num[np.ndarray, "S P K"],
    alpha: float = 0.1,
    *,
    common_starts: bool = False,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """Return CVaR_alpha, the mean of the lowest share alpha of partner means; None for K = 1.

    The tail is chosen on even episodes and valued on odd ones, and vice versa, because the lowest
    of noisy means are low by chance too. The partner at the boundary counts with a fraction. Starts
    that all partners have in common are resampled within each half.
    """
    if returns.shape[2] < 2:
        raise ValueError(
            "CVaR needs 2 or more episodes a pair: one half chooses the tail and the other values "
            "it"
        )
    seeds, partners, _ = returns.shape
    halves = returns[:, :, 0::2], returns[:, :, 1::2]

    def evaluate(means: Sequence[np.ndarray], partner_counts: np.ndarray) -> np.ndarray:
        tails = [
            (tail_weights(a, partner_counts, alpha) * b).sum(axis=1)
            for a, b in (means, reversed(means))
        ]
        return (tails[0] + tails[1]) / 2

    even, odd = (half.mean(axis=(0, 2))[None] for half in halves)
    point = float(evaluate((even, odd), np.ones((1, partners)))[0])
    counts = crossed_counts(returns.shape, common_starts, resamples, seed)
    rng = np.random.default_rng([seed, 1])
    means = []
    for half in halves:
        starts = None
        if counts.starts is not None:
            starts = draw_counts(half.shape[2], resamples, rng)
        means.append(_partner_means(half, counts.seeds, starts))
    replicates = evaluate(means, counts.partners)
    to = counts.generalises_to
    return Interval(point, interval(replicates, to), seeds * partners, to)


def _partner_means(
    returns: np.ndarray, seed_counts: np.ndarray, starts: np.ndarray | None
) -> np.ndarray:
    """Return each partner's mean [B, P] of returns [S, P, K] under counts of seeds and starts."""
    seeds, _, episodes = returns.shape
    if starts is None:
        return seed_counts @ returns.mean(axis=2) / seeds
    summed = np.einsum("bs,spk,bk->bp", seed_counts, returns, starts, optimize=True)
    return summed / (seeds * episodes)


def _halves(returns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return returns[:, :, 0::2].mean(axis=2), returns[:, :, 1::2].mean(axis=2)
