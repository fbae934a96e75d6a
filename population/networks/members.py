"""The axis of members: M train side by side, each with its share of N simulations, in order."""

from collections.abc import Callable
from typing import Any

import jax


def member_map(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that maps `function` over the leading axis of all arguments.

    Vectorised on accelerators. On a CPU members are taken in turn: a product of plain matrices is
    faster there than a batched one.
    """

    def mapped(*args: Any) -> Any:
        if jax.default_backend() != "cpu":
            return jax.vmap(function)(*args)
        if jax.tree.leaves(args)[0].shape[0] == 1:
            result = function(*jax.tree.map(lambda leaf: leaf[0], args))
            return jax.tree.map(lambda leaf: leaf[None], result)
        return jax.lax.map(lambda args: function(*args), args)

    return mapped


def to_members(tree: Any, members: int) -> Any:
    """Return a tree whose leaves [N, ...] are reshaped to [M, N/M, ...]."""
    return jax.tree.map(
        lambda leaf: leaf.reshape(members, leaf.shape[0] // members, *leaf.shape[1:]), tree
    )


def to_simulations(tree: Any) -> Any:
    """Return a tree whose leaves [M, N/M, ...] are reshaped to [N, ...]."""
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), tree)
