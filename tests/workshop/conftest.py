"""The small population of the zoo's tests, which the workshop publishes."""

from tests.zoo.conftest import cache, hub, large, params, publish_to, registry, specs, team, teams

__all__ = ["cache", "hub", "large", "params", "publish_to", "registry", "specs", "team", "teams"]
