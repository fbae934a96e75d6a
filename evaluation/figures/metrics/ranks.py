"""Rank methods by tests of all pairs, with simultaneous confidence sets for the ranks.

Overlapping intervals do not decide which mean is higher, nor does a place in a sorted list. Here
every pair of methods is tested, and with 95% confidence no claim of the whole list is wrong. Ranks
follow from the claims, as in Mogstad, Romano, Shaikh and Wilhelm, "Inference for Ranks" (Review of
Economic Studies, 2024). A pair's test uses only the scores of its two methods, so other rows change
it only by their number.

**The test of a pair.** Methods a and b with seeds S_a and S_b met the same P partners. The
difference of their means over seeds and partners has two sources of chance: which seeds were
trained, and which partners were met. With s_a^2 the variance of a's means over partners between its
seeds, and V_p that of the paired differences between partners, divided by P, a is above b if

    (mean_a - mean_b)^2 > t(f)^2 (s_a^2 / S_a + s_b^2 / S_b) + t(P - 1)^2 V_p        (Cochran, 1964)

where t are two-sided quantiles of Student and f are the degrees of freedom of the sum of the two
seed variances: Satterthwaite's, with 1 added to each before and taken off after, as Welch (1947)
does with 2, and no more than their sum. A quantile for each source keeps the level where two seeds
happen to be alike; with one quantile for the sum of all three, 10 to 20% of lists are wrong then.

**Groups of partners.** Where each group of partners counts the same in a method's mean, whatever
its size, scores are weighted so that their mean is the mean of the groups' means, and V_p is the
sum of the groups' own variances, at Satterthwaite's degrees of freedom: other draws have as many
partners of each group. If a group has a single partner, V_p is that of all weighted differences,
which is too wide.

**All pairs at once.** A pair is tested at 5% divided by the number of pairs that may still be
equal: first all, then fewer, since equal methods form groups and every pair of a group must still
be open (Shaffer, 1986; the number is bounded from above by the cores of the graph of open pairs).

**Methods that are not in the list.** A list from which somebody may have taken methods after their
scores were known, such as all but the luckiest, has too many wrong claims. `unseen` counts those
methods, and every pair with one of them is counted among the pairs that may be equal. The level
then holds for all methods together, whichever of them are listed.

**Few seeds.** Two or three seeds hardly tell how far a method's seeds differ. `seed_sd` says it
beforehand, from measurements of other methods, and is lent to methods with fewer than five seeds
while their own seeds do not contradict it. It counts n degrees of freedom: 2, but 0.6 of methods
with two seeds, which may be alike by luck where seeds differ much. With r = min(1, seed_sd^2 /
s^2), the variance is max(s^2, (n seed_sd^2 + (S - 1) s^2) / (n + S - 1)) at S - 1 + r n degrees.
`SEED_SDS` has the values of the zoo's egos. No row of the list is looked at for it, so that no row
can spoil it.

**Assumptions.** Means of seeds are about normal, robots and partners are drawn independently, and
`seed_sd`, where it is given, is no less than half of the truth for most methods. A method with one
seed is that robot: its rank speaks of new partners, not of new seeds of its training.

**Measured** in made-up worlds; docs/tables/ranks.csv has the whole table. Six methods, seeds of
standard deviation 40; true orders found with methods 100 apart, and lists with a wrong rank with
equal ones, the worst of several worlds:

| seeds                                        | 2  | 3  | 4  | 5  | 10  |
| -------------------------------------------- | -- | -- | -- | -- | --- |
| % of orders found, `seed_sd` 40              | 38 | 81 | 92 | 96 | 100 |
| % of orders found, nothing known             | 10 | 66 | 89 | 96 | 100 |
| % of lists wrong, `seed_sd` 40               | 4  | 2  | 2  | 4  | 4   |
| % of lists wrong, nothing known              | 3  | 4  | 5  | 4  | 4   |
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Int

from assistax_base.statistics import score_matrix
from assistax_envs.registered import ByTask
from evaluation.figures.metrics.generalisation import group_weights

CONFIDENCE = 0.95
ENOUGH_SEEDS = 5  # from here on a method's own seeds say how far they differ
_LENT_DF, _LENT_TO_TWO = 2.0, 0.6  # of what is known beforehand, and to methods with two seeds
_ROUNDING = 1e-9  # share of the largest mean, below which a difference counts as zero
_ODD_ROWS = 10  # most rows to leave out when the pairs that may be equal are counted
_INVERSE_DF = np.linspace(1e-4, 1.0, 400)  # nodes at which Student's quantiles are computed


# Standard deviation between seeds of one method of their means over partners: root mean square over
# the zoo's PPO and SAC egos of each task. tests/evaluation/test_ranks.py computes those of the
# paper's tasks; the others are of robots of the withdrawn release v2 (docs/log/statistics.md).
SEED_SDS: Mapping[str, float] = ByTask(
    lambda kind: kind.seed_sd or 0.0, lambda kind: kind.seed_sd is not None
)


@dataclasses.dataclass(frozen=True)
class Ranks:
    """Simultaneous confidence sets for the ranks of M methods."""

    better: Bool[np.ndarray, "M M"]  # whether method j is certainly better than method k

    @property
    def places(self) -> Int[np.ndarray, " M"]:
        """Best rank of each method; methods without a significant difference share it."""
        return 1 + self.better.sum(axis=0)

    @property
    def lowest(self) -> Int[np.ndarray, " M"]:
        """Worst rank of each method."""
        return len(self.better) - self.better.sum(axis=1)


def rank_methods(
    scores: Sequence[np.ndarray],
    *,
    groups: Sequence[str] | None = None,
    seed_sd: float | None = None,
    unseen: int = 0,
    confidence: float = CONFIDENCE,
) -> Ranks:
    """Return the ranks of methods by their mean over partners, or over groups of partners.

    Args:
        scores: Mean returns [S, P] of each method: its seeds, and the same P partners in the same
            order and on the same episodes for every method.
        groups: The group of each partner [P], if each group counts the same in a method's mean.
        seed_sd: Standard deviation between seeds of one method, known beforehand, such as
            `SEED_SDS[task]`; None if unknown.
        unseen: Number of further methods that were scored and are not listed.
        confidence: Confidence that no claim of the result is wrong.

    Raises:
        ValueError: There are fewer than two partners, methods have different numbers of partners,
            `seed_sd` is not positive, or `unseen` is negative.
    """
    matrices = _check(scores)
    if seed_sd is not None and not 0 < seed_sd < np.inf:
        raise ValueError(f"seed_sd is {seed_sd}; allowed is a positive number of points, or None")
    if unseen < 0:
        raise ValueError(f"unseen is {unseen}; allowed is 0 or a number of methods")
    if groups is not None and len(groups) != matrices[0].shape[1]:
        raise ValueError(
            f"there are {len(groups)} groups for {matrices[0].shape[1]} partners; give one for "
            "each partner"
        )
    pairs = _compare(matrices, seed_sd, groups)
    return Ranks(_transitive_closure(_step_down(pairs, 1 - confidence, unseen)))


@dataclasses.dataclass(frozen=True)
class _Pairs:
    """Differences of all pairs of methods, and the variance of each by its source."""

    difference: np.ndarray  # [M, M] mean of method j less that of k
    of_seeds: np.ndarray  # [M, M]
    seed_df: np.ndarray  # [M, M]
    of_partners: np.ndarray  # [M, M]
    partner_df: np.ndarray  # [M, M]
    rounding: float

    def apart(self, level: float) -> np.ndarray:
        """Return a mask [M, M] of the pairs that differ at this level, two-sided."""
        from scipy.special import stdtrit  # Student's quantiles; not loaded at every start

        # Convex between the nodes, so what is read off is no less than the quantile.
        nodes = -stdtrit(1 / _INVERSE_DF, level / 2)
        seed_quantile = np.interp(1 / self.seed_df, _INVERSE_DF, nodes)
        partner_quantile = stdtrit(self.partner_df, level / 2)
        bar = seed_quantile**2 * self.of_seeds + partner_quantile**2 * self.of_partners
        return np.square(self.difference) > np.maximum(bar, self.rounding**2)


def _compare(
    matrices: Sequence[np.ndarray], seed_sd: float | None, groups: Sequence[str] | None
) -> _Pairs:
    if groups is not None:
        weights = group_weights(groups)
        matrices = [matrix * weights for matrix in matrices]
    columns = np.stack([matrix.mean(axis=0) for matrix in matrices])  # [M, P]
    means = columns.mean(axis=1)
    of_partners, partner_df = _partner_variance(columns, groups)
    variances, df = np.array([_seed_variance(matrix, seed_sd) for matrix in matrices]).T
    of_seeds = variances[:, None] + variances
    return _Pairs(
        difference=means[:, None] - means,
        of_seeds=of_seeds,
        seed_df=_summed_df(variances, df, of_seeds),
        of_partners=of_partners,
        partner_df=partner_df,
        rounding=_ROUNDING * float(np.abs(means).max()),
    )


def _partner_variance(
    columns: np.ndarray, groups: Sequence[str] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the variance [M, M] of the mean of paired differences, and its degrees of freedom.

    Args:
        columns: Means over seeds [M, P], weighted by the partners' groups.
        groups: The group of each partner; None if they are of one.
    """
    named = np.array(groups if groups is not None else [""] * columns.shape[1])
    masks = [named == name for name in sorted(set(named.tolist()))]
    if min(mask.sum() for mask in masks) < 2:
        masks = [np.ones(len(named), bool)]
    total = np.zeros((len(columns), len(columns)))
    squares = np.zeros_like(total)
    for mask in masks:
        count = int(mask.sum())
        centred = columns[:, mask] - columns[:, mask].mean(axis=1, keepdims=True)
        products = centred @ centred.T
        own = np.diagonal(products)
        sums = np.maximum(own[:, None] + own - 2 * products, 0.0)
        part = sums * count / ((count - 1) * columns.shape[1] ** 2)
        total += part
        squares += part**2 / (count - 1)
    most = float(len(named) - len(masks))
    df = np.where(squares > 0, total**2 / np.where(squares > 0, squares, 1.0), most)
    return total, np.minimum(df, most)


def _seed_variance(matrix: np.ndarray, seed_sd: float | None) -> tuple[float, float]:
    """Return the variance of a method's mean over new seeds, and its degrees of freedom."""
    seeds = len(matrix)
    if seeds == 1:  # the method is this one robot, and no other seed is spoken of
        return 0.0, np.inf
    variance, df = float(matrix.mean(axis=1).var(ddof=1)), seeds - 1
    if seed_sd is None or seeds >= ENOUGH_SEEDS:
        return variance / seeds, df
    lent, known = _LENT_TO_TWO if seeds == 2 else _LENT_DF, seed_sd**2
    shrunken = (lent * known + df * variance) / (lent + df)
    agrees = known / max(variance, known)
    return max(variance, shrunken) / seeds, df + agrees * lent


def _summed_df(variances: np.ndarray, df: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Degrees of freedom [M, M] of the sum of two methods' variances."""
    shares = np.square(variances) / (df + 1)
    shares = shares[:, None] + shares
    nothing = shares == 0  # two single robots, or seeds that are all alike
    summed = np.square(total) / np.where(nothing, 1.0, shares) - 1
    least = np.minimum(df[:, None], df)
    return np.where(nothing, least, np.clip(summed, least, df[:, None] + df))


def _step_down(pairs: _Pairs, alpha: float, unseen: int = 0) -> np.ndarray:
    """Return a mask [M, M], True if j is significantly better than k, by a step-down test.

    Pairs with `unseen` methods stay open to the end.
    """
    hidden = unseen * len(pairs.difference) + unseen * (unseen - 1) / 2
    is_open = ~np.eye(len(pairs.difference), dtype=bool)
    most = np.inf
    while is_open.any():
        most = min(most, _most_equal(is_open) + hidden)
        apart = is_open & pairs.apart(alpha / max(most, 1))
        if not apart.any():
            break
        is_open &= ~apart
    np.fill_diagonal(is_open, True)
    return ~is_open & (pairs.difference > 0)


def _most_equal(is_open: np.ndarray) -> float:
    """Return an upper bound of the number of pairs that can be equal at once.

    Equal methods form groups in which every pair is open. A method's group has at most its core
    number of other members. A method that is left out of the count is equal to at most that number
    of others.
    """
    left_out, cores = 0.0, _core_numbers(is_open)
    bound = cores.sum() / 2
    for _ in range(_ODD_ROWS):
        widest = int(is_open.sum(axis=0).argmax())
        left_out += cores[widest]
        is_open = is_open.copy()
        is_open[widest] = is_open[:, widest] = False
        cores = _core_numbers(is_open)
        smaller = left_out + cores.sum() / 2
        if smaller >= bound:
            break
        bound = smaller
    return float(bound)


def _core_numbers(graph: np.ndarray) -> np.ndarray:
    """Return the core number [M] of each node of a graph given by its adjacency matrix."""
    links = graph.astype(np.float32)
    degrees, cores, core = links.sum(axis=1), np.zeros(len(graph)), 0.0
    left = np.ones(len(graph), bool)
    while left.any():
        core = max(core, float(degrees[left].min()))
        goes = left & (degrees <= core)
        cores[goes] = core
        degrees -= links[:, goes].sum(axis=1)
        left &= ~goes
    return cores


def _transitive_closure(better: np.ndarray) -> np.ndarray:
    """Return the transitive closure of a relation [M, M]."""
    while True:
        closed = better | (better.astype(np.float32) @ better.astype(np.float32) > 0)
        if (closed == better).all():
            return better
        better = closed


def _check(scores: Sequence[np.ndarray]) -> list[np.ndarray]:
    matrices = [score_matrix(matrix) for matrix in scores]
    partners = {matrix.shape[1] for matrix in matrices}
    if len(partners) != 1 or min(partners) < 2:
        raise ValueError(
            f"the methods have {', '.join(map(str, sorted(partners))) or 'no'} partners; a ranking "
            "needs the same 2 or more for every method"
        )
    return matrices
