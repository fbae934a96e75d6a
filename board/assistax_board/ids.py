"""Random ids, which reveal neither a count nor an origin."""

import secrets

_LETTERS = "23456789abcdefghjkmnpqrstuvwxyz"  # none that is taken for another


def new_id(length: int = 12) -> str:
    """Return a random id; 12 letters have 59 bits."""
    return "".join(secrets.choice(_LETTERS) for _ in range(length))
