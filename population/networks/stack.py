"""Policies of one spec, stacked for storage and play. Uses NumPy alone."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Generic, TypeVar

import numpy as np

from population.networks.seat import Seat

S = TypeVar("S", bound=Seat)


@dataclasses.dataclass(frozen=True, eq=False)
class PolicyStack(Generic[S]):
    """Policies of one spec, whose parameters are stacked along a first axis G."""

    spec: S
    ids: tuple[str, ...]  # [G], each once
    params: Mapping[str, Any]  # nested, leaves [G, ...] in the order of `ids`

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, rows: Sequence[int]) -> "PolicyStack[S]":
        """Return a stack of the policies in these rows, in this order."""
        ids = tuple(self.ids[row] for row in rows)
        return PolicyStack(
            self.spec, ids, map_leaves(lambda leaf: leaf[np.asarray(rows)], self.params)
        )

    def row(self, index: int) -> dict[str, Any]:
        """Return the parameters of one policy, without the stacked axis."""
        return map_leaves(lambda leaf: leaf[index], self.params)


def stack_policies(
    policies: Iterable[tuple[str, S, Mapping[str, Any]]],
) -> tuple[PolicyStack[S], ...]:
    """Return a stack for each spec of policies (id, spec, parameters), in order of appearance."""
    by_spec: dict[S, list[tuple[str, Mapping[str, Any]]]] = {}
    for name, spec, params in policies:
        by_spec.setdefault(spec, []).append((name, params))
    return tuple(
        PolicyStack(
            spec, tuple(name for name, _ in members), _stacked([params for _, params in members])
        )
        for spec, members in by_spec.items()
    )


def map_leaves(function: Any, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested parameters with `function` applied to each leaf."""
    return {
        name: map_leaves(function, value) if isinstance(value, Mapping) else function(value)
        for name, value in params.items()
    }


def flatten(params: Mapping[str, Any], prefix: str = "") -> dict[str, np.ndarray]:
    """Return the arrays of nested parameters by '/'-joined path."""
    leaves = {}
    for name, value in params.items():
        if isinstance(value, Mapping):
            leaves |= flatten(value, f"{prefix}{name}/")
        else:
            leaves[f"{prefix}{name}"] = np.asarray(value, order="C")
    return leaves


def unflatten(leaves: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the nested parameters of leaves by '/'-joined path: the inverse of `flatten`."""
    tree: dict[str, Any] = {}
    for path, value in leaves.items():
        *folders, name = path.split("/")
        node = tree
        for folder in folders:
            node = node.setdefault(folder, {})
        node[name] = value
    return tree


def _stacked(trees: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return nested parameters whose leaves are stacked along a new first axis."""
    return {
        name: _stacked([tree[name] for tree in trees])
        if isinstance(value, Mapping)
        else np.stack([np.asarray(tree[name]) for tree in trees])
        for name, value in trees[0].items()
    }
