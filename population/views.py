"""Views: the observations of robots beside the plain one. Imports no JAX.

A robot with another view than the plain one is a row to compare with. No release has such a robot.
"""

import enum
from collections.abc import Mapping
from typing import Any

from assistax_envs.preferences import Told

CLAIM = "told"  # key of a view in run configurations and in the metadata of robots' files
CONDITION = "condition"  # key of a view in the engine of a job
_PARTNER: Told = "partner"


class View(enum.Enum):
    """Observations of a robot; the value names them in a job's identity."""

    PLAIN = ""
    PREFERENCE = "told"  # the human's preference too
    NUMBERS = "told-partner"  # the preference and all numbers of a person

    @classmethod
    def of_told(cls, told: Told) -> "View":
        """Return the robot's view for a value of `told` in a run's configuration."""
        if told == _PARTNER:
            return cls.NUMBERS
        return cls.PREFERENCE if told else cls.PLAIN

    @classmethod
    def claimed(cls, claims: Mapping[str, Any]) -> "View":
        """Return the view that a robot's file claims; values that no file has are plain."""
        told = claims.get(CLAIM)
        return cls.of_told(told) if told is True or told == _PARTNER else cls.PLAIN

    @property
    def told(self) -> Told:
        """The value of `told` in a run's configuration."""
        return _PARTNER if self is View.NUMBERS else self is View.PREFERENCE

    @property
    def condition(self) -> str:
        """Name of the view in a job's identity; empty for the plain one."""
        return self.value

    @property
    def claim(self) -> dict[str, Told]:
        """Metadata of robots with this view; empty for the plain one."""
        return {CLAIM: self.told} if self.told else {}

    def engine(self, engine: Mapping[str, str]) -> dict[str, str]:
        """Return an engine's name and version with the condition of this view, if it has one."""
        return {**engine, **({CONDITION: self.condition} if self.condition else {})}

    def make(
        self,
        task: str,
        backend: str = "auto",
        *,
        version: int | None = None,
        numbers: Any = None,
    ) -> Any:
        """Return the environment of a task in which robots have this view.

        Args:
            task: The task.
            backend: Physics.
            version: Version of the environment; the newest if not given.
            numbers: Numbers [P, 25] of persons, as `EnvParams.person` counts them; None if the
                partners are no persons.

        Raises:
            ValueError: Robots observe numbers, and there are no persons.
        """
        from assistax_envs import make
        from population.networks.spec import ROLES

        observers: dict[str, Any] = {"told": ROLES} if self.told else {}
        env = make(task, backend, version=version, **observers)
        if self is not View.NUMBERS:
            return env
        from population.environment import ToldNumbers

        return ToldNumbers(env, numbers)


def plain_engine(engine: Mapping[str, str] | None) -> dict[str, str]:
    """Return a job's engine without the condition of a view."""
    return {name: value for name, value in (engine or {}).items() if name != CONDITION}
