"""The small population of the zoo's tests, whose files are damaged here."""

from tests.zoo.conftest import cache, hub, large, registry

__all__ = ["cache", "hub", "large", "registry"]
