"""A Merkle tree as in RFC 6962: one hash that commits to many leaves.

Leaves and inner nodes are hashed with different first bytes, so that neither passes for the other.
"""

import hashlib
from collections.abc import Sequence
from typing import Any

from assistax_board.store.canonical import canonical


def leaf_hash(value: Any) -> bytes:
    """Return the hash of a leaf; a leaf that could be guessed needs a salt in its value."""
    return hashlib.sha256(b"\0" + canonical(value)).digest()


def merkle_root(values: Sequence[Any]) -> str:
    """Return the root over the leaves in this order, in hex."""
    if not values:
        raise ValueError("a tree has at least one leaf")
    return _root([leaf_hash(value) for value in values]).hex()


def _root(hashes: list[bytes]) -> bytes:
    if len(hashes) == 1:
        return hashes[0]
    half = 1 << ((len(hashes) - 1).bit_length() - 1)  # the largest power of two below
    return hashlib.sha256(b"\1" + _root(hashes[:half]) + _root(hashes[half:])).digest()
