"""One way to write a value as bytes, so that everybody who hashes or signs it gets the same."""

import hashlib
import json
from typing import Any


def canonical(value: Any) -> bytes:
    """Return the JSON of a value: keys sorted, no spaces, ASCII; NaN is refused."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode("ascii")


def digest(value: Any) -> str:
    """Return the hex sha256 of a value's canonical JSON."""
    return hashlib.sha256(canonical(value)).hexdigest()
