"""Measures for the paper's claims, of returns [robots, humans] and of scores [S, P].

In a matrix the same team stands in row i and column i, so that self-play is the diagonal.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.cluster import hierarchy
from scipy.spatial import distance

from assistax_base.statistics import score_matrix
from evaluation.figures.bootstrap import Counts, Interval, draw_counts, interval, replicate_crossed
from evaluation.figures.clustering import least_members

PERMUTATIONS = 99
RESAMPLES = 2000
_RESAMPLED_MATRICES = 400
_SETTLED = 30  # rounds after which the filled diagonal no longer moves


@dataclasses.dataclass(frozen=True)
class Exchange:
    """The two branches of the tree that lose the most with each other, and their significance."""

    loss: float  # share of the return; 0 if no two branches lose
    # Members of either branch, as rows of the matrix; empty if no two branches lose.
    groups: tuple[np.ndarray, ...]
    null: float  # 95th percentile of the losses under permutation
    p: float  # share of permutations that reach the loss


@dataclasses.dataclass(frozen=True)
class VarianceShares:
    """Shares of the variance of cross-play returns over pairs; they sum to 1."""

    robot: Interval  # of the robots' means
    human: Interval  # of the humans' means
    rest: Interval  # of interactions of robot and human, and the noise of the episodes


def incompatible_share(matrix: np.ndarray, fraction: float = 0.5) -> float:
    """Return the share of pairs of different teams that earn less than a fraction of self-play.

    The yardstick is the lesser of the two teams' self-play returns: a poor team is no evidence of
    incompatibility. If that return is not positive, the pair counts as compatible.
    """
    own = np.diag(matrix)
    lesser = np.minimum(own[:, None], own[None])
    apart = ~np.eye(len(matrix), dtype=bool)
    return float(np.mean(((lesser > 0) & (matrix < fraction * lesser))[apart]))


def largest_exchange_loss(
    matrix: np.ndarray, *, permutations: int = PERMUTATIONS, seed: int = 0
) -> Exchange:
    """Return the two branches of Figure 4's tree, of at least 5% of the teams, that lose the most.

    Two branches lose `1 - max(A's robots with B's humans, B's with A's) / min(within A, within B)`,
    of mean cross-play returns. So both lose in comparison with the poorer of the two, which is not
    the case if one branch merely has the better teams.

    The null distribution permutes the interactions (the returns minus the robots' and the humans'
    means) among each human's robots; self-play is left out. Every permutation gets its own tree.

    Args:
        matrix: returns [T, T].
        permutations: number of them.
        seed: seed of the permutations.
    """
    loss, groups = _exchange(matrix)
    filled = _fill_diagonal(matrix)
    rest = _interactions(filled)
    rng = np.random.default_rng(seed)
    apart = ~np.eye(len(rest), dtype=bool)
    null = np.array(
        [_exchange(filled - rest + _shuffled(rest, apart, rng))[0] for _ in range(permutations)]
    )
    p = (1 + np.count_nonzero(null >= loss)) / (1 + permutations)
    return Exchange(loss, groups, float(np.quantile(null, 0.95)), float(p))


def variance_shares(
    matrix: np.ndarray, *, resamples: int = _RESAMPLED_MATRICES, seed: int = 0
) -> VarianceShares:
    """Return the shares of robots, humans and the rest in the variance of cross-play returns.

    Two-way analysis of variance of [T, T]; the means' prediction replaces the diagonal, which is
    self-play. Resampling adds about 1 / T of the rest to either mean's share, so that a share near
    0 may lie below its interval.
    """
    filled = _fill_diagonal(matrix)
    rng = np.random.default_rng(seed)
    teams = len(filled)
    draws = np.array(
        [_shares(filled[np.ix_(i, i)]) for i in rng.integers(0, teams, (resamples, teams))]
    )
    n = teams * (teams - 1)
    intervals = [
        Interval(value, interval(column, "teams"), n, "teams")
        for value, column in zip(_shares(filled), draws.T, strict=True)
    ]
    return VarianceShares(*intervals)


def probability_of_improvement(x: np.ndarray, y: np.ndarray) -> float:
    """Return the mean over partners of P(seed of x beats seed of y), ties counting one half.

    Args:
        x: scores [S, P] of one method.
        y: scores [S', P] of the other, the same partners in the same order.
    """
    x, y = score_matrix(x), score_matrix(y)
    if x.shape[1] != y.shape[1]:
        raise ValueError(
            f"x has {x.shape[1]} partners and y has {y.shape[1]}; give both the same partners"
        )
    return float(np.mean((x[:, None] > y[None]) + 0.5 * (x[:, None] == y[None])))


def branches(linkage: np.ndarray) -> list[np.ndarray]:
    """Return the leaves below each node of a tree [n - 1, 4] as SciPy has it, the root last."""
    below = [np.array([leaf]) for leaf in range(len(linkage) + 1)]
    for left, right in linkage[:, :2].astype(int):
        below.append(np.concatenate([below[left], below[right]]))
    return below[len(linkage) + 1 :]


def improvement(
    x: np.ndarray,
    y: np.ndarray,
    *,
    stratified: bool = False,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Interval:
    """Probability that a seed of x beats a seed of y with the same partner, with its 95% interval.

    Args:
        x: scores [S, P].
        y: scores [S', P] with the same partners.
        stratified: columns are independent runs, and only the seeds within each are resampled; else
            a seed is one policy that meets every partner: whole seeds, then partners are resampled.
        resamples: number of bootstrap draws.
        seed: seed of the draws.
    """
    x, y = score_matrix(x), score_matrix(y)
    point = probability_of_improvement(x, y)
    wins = (x[:, None] > y[None]) + 0.5 * (x[:, None] == y[None])  # [S, S', P]
    rng = np.random.default_rng(seed)
    partners = x.shape[1]
    if stratified:
        a, b = (_counts_by_column(len(scores), partners, resamples, rng) for scores in (x, y))
        columns = np.ones((resamples, partners))
        to = "seeds"
    else:
        a, b = (draw_counts(len(scores), resamples, rng)[:, :, None] for scores in (x, y))
        columns = draw_counts(partners, resamples, rng)
        to = "seeds and partners"
    sums = np.zeros((resamples, partners))
    for s, row in enumerate(wins):
        sums += a[:, s] * np.einsum(
            "btp,tp->bp", np.broadcast_to(b, (resamples, len(y), partners)), row
        )
    draws = (sums * columns).sum(axis=1) / wins.size
    return Interval(point, interval(draws, to), wins.size, to)


def relative_gap(
    scores: np.ndarray, sides: Sequence[str | None], *, resamples: int = RESAMPLES, seed: int = 0
) -> Interval:
    """(M_train - M_test) / M_train of scores [S, P], with an interval over new seeds."""
    scores, labels = score_matrix(scores), np.array(sides, object)
    counts = draw_counts(len(scores), resamples, np.random.default_rng(seed))
    train, test = (
        replicate_crossed(
            part, Counts(counts, np.ones((resamples, part.shape[1]), np.int64), None, "seeds")
        )
        for part in (scores[:, labels == "train"], scores[:, labels == "test"])
    )
    value = 1 - test.mean / train.mean
    ci = interval(1 - test.means / train.means, "seeds" if len(scores) > 1 else "nothing")
    return Interval(float(value), ci, scores.size, "seeds")


def _team_tree(matrix: np.ndarray) -> np.ndarray:
    """Return the tree of `clustering.cluster_teams`, quicker: it orders no leaves."""
    return hierarchy.average(distance.pdist(np.concatenate([matrix, matrix.T], axis=1)))


def _mean_apart(block: np.ndarray) -> float:
    return float(block[~np.eye(len(block), dtype=bool)].mean())


def _fill_diagonal(matrix: np.ndarray) -> np.ndarray:
    """Replace self-play by robot's mean + human's mean - mean of all."""
    filled = np.array(matrix, float)
    own = np.arange(len(filled))
    filled[own, own] = _mean_apart(filled)
    for _ in range(_SETTLED):
        filled[own, own] = filled.mean(axis=1) + filled.mean(axis=0) - filled.mean()
    return filled


def _interactions(filled: np.ndarray) -> np.ndarray:
    return (
        filled
        - filled.mean(axis=1, keepdims=True)
        - filled.mean(axis=0, keepdims=True)
        + filled.mean()
    )


def _exchange(matrix: np.ndarray) -> tuple[float, tuple[np.ndarray, ...]]:
    large = [
        group
        for group in branches(_team_tree(matrix))[:-1]
        if len(group) >= least_members(len(matrix))
    ]
    if len(large) < 2:
        return 0.0, ()
    members = np.zeros((len(large), len(matrix)))
    for row, group in zip(members, large, strict=True):
        row[group] = 1
    sizes = members.sum(axis=1)
    sums = members @ (matrix * ~np.eye(len(matrix), dtype=bool)) @ members.T
    within, across = np.diag(sums) / (sizes * (sizes - 1)), sums / np.outer(sizes, sizes)
    poorer = np.minimum(within[:, None], within[None])
    known = (members @ members.T == 0) & (poorer > 0)
    losses = np.where(known, 1 - np.maximum(across, across.T) / np.where(known, poorer, 1.0), 0.0)
    first, second = np.unravel_index(int(losses.argmax()), losses.shape)
    if losses[first, second] <= 0:
        return 0.0, ()
    return float(losses[first, second]), (large[first], large[second])


def _shuffled(matrix: np.ndarray, apart: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    shuffled = matrix.copy()
    for column in range(matrix.shape[1]):
        rows = np.flatnonzero(apart[:, column])
        shuffled[rows, column] = matrix[rng.permutation(rows), column]
    return shuffled


def _shares(matrix: np.ndarray) -> tuple[float, float, float]:
    total = float(np.square(matrix - matrix.mean()).sum())
    if total <= 0:
        return float("nan"), float("nan"), float("nan")
    means = [
        np.square(matrix.mean(axis=axis) - matrix.mean()).sum() * len(matrix) for axis in (1, 0)
    ]
    robot, human = (float(part / total) for part in means)
    return robot, human, 1 - robot - human


def _counts_by_column(
    seeds: int, columns: int, resamples: int, rng: np.random.Generator
) -> np.ndarray:
    """Counts [B, S, P] of seeds resampled for each column by itself."""
    return rng.multinomial(seeds, np.full(seeds, 1.0 / seeds), size=(resamples, columns)).transpose(
        0, 2, 1
    )
