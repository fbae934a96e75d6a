"""Hashes of bytes, JSON and trees of JSON. Published ids and roots depend on them.

A Merkle tree is one hash that commits to many leaves, as in RFC 6962. Leaves and inner nodes begin
with different bytes, so that neither passes for the other; an odd node goes up as it is.
"""

import hashlib
import json
from collections.abc import Iterable
from typing import Any

_COMPACT, _SPACED = (",", ":"), (", ", ": ")


def sha256(data: bytes) -> str:
    """Return the hex sha256 of the bytes."""
    return hashlib.sha256(data).hexdigest()


def canonical_json(value: Any, *, spaced: bool = False) -> bytes:
    """Return the JSON of a value that is hashed or signed: keys sorted, ASCII only.

    Args:
        value: JSON-ready.
        spaced: With a space after commas and colons, which manifests of results, policy files and
            specs of networks have had since the first release.

    Raises:
        ValueError: A number is NaN or infinite.
    """
    separators = _SPACED if spaced else _COMPACT
    return json.dumps(value, sort_keys=True, separators=separators, allow_nan=False).encode()


def json_sha256(value: Any, *, spaced: bool = False) -> str:
    """Return the hex sha256 of a value's canonical JSON."""
    return sha256(canonical_json(value, spaced=spaced))


def leaf_sha256(value: Any) -> str:
    """Return the hash of a tree's leaf. A leaf that could be guessed needs a salt in its value."""
    return sha256(b"\x00" + canonical_json(value))


def merkle_root(leaves: Iterable[str]) -> str:
    """Return the root over hashes of leaves in their order, in hex.

    Raises:
        ValueError: There is no leaf.
    """
    level = [bytes.fromhex(leaf) for leaf in leaves]
    if not level:
        raise ValueError("a tree has at least one leaf")
    while len(level) > 1:
        pairs = [level[start : start + 2] for start in range(0, len(level), 2)]
        level = [
            hashlib.sha256(b"\x01" + b"".join(pair)).digest() if len(pair) == 2 else pair[0]
            for pair in pairs
        ]
    return level[0].hex()
