"""Random words that name things: they do not tell how many there are, nor who made them."""

import secrets

_LETTERS = "23456789abcdefghjkmnpqrstuvwxyz"  # none that is taken for another


def new_id(length: int = 12) -> str:
    """Return a random id; 12 letters have 59 bits."""
    return "".join(secrets.choice(_LETTERS) for _ in range(length))
