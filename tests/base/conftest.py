"""The small population of the zoo's tests, whose files are damaged here."""

from tests.zoo.conftest import cache, large, registry

__all__ = ["cache", "large", "registry"]
