"""Factorisation of the joint-space inertia, whose zeros follow the tree.

M = L^T D L with L unit lower triangular: L[i, j] is non-zero only where link j carries link i, as
in M itself (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 6.5), so that branches and
trees cost nothing for each other.
"""

from collections.abc import Sequence

from assistax_envs.physics.fused.expressions import Scalar, multiply_subtract, reciprocal
from assistax_envs.physics.fused.inertia import Entries


def ancestors(parents: Sequence[int], i: int) -> list[int]:
    """Return the dofs that carry dof `i`, the nearest first."""
    chain = []
    while (i := parents[i]) >= 0:
        chain.append(i)
    return chain


def entry_order(parents: Sequence[int]) -> list[tuple[int, int]]:
    """Return the places of M's entries in the order in which the solver keeps them."""
    return [(i, j) for i in range(len(parents)) for j in [*reversed(ancestors(parents, i)), i]]


def factorise(matrix: Entries, parents: Sequence[int]) -> Entries:
    """Return L below the diagonal and 1 / D on it."""
    factor = dict(matrix)
    for k in reversed(range(len(parents))):
        inverse = reciprocal(factor[k, k])
        carriers = ancestors(parents, k)
        scaled = {i: factor[k, i] * inverse for i in carriers}
        for i in carriers:
            for j in [i, *ancestors(parents, i)]:
                factor[i, j] = multiply_subtract(scaled[i], factor[k, j], factor[i, j])
        for i, value in scaled.items():
            factor[k, i] = value
        factor[k, k] = inverse
    return factor


def solve(factor: Entries, parents: Sequence[int], right: Sequence[Scalar]) -> list[Scalar]:
    """Return x of M x = right."""
    x: list[Scalar] = list(right)
    for i in reversed(range(len(x))):
        for j in ancestors(parents, i):
            x[j] = multiply_subtract(factor[i, j], x[i], x[j])
    x = [value * factor[i, i] for i, value in enumerate(x)]
    for i in range(len(x)):
        for j in ancestors(parents, i):
            x[i] = multiply_subtract(factor[i, j], x[j], x[i])
    return x
