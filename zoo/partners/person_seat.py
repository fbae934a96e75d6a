"""Spec of persons in the human's seat, which makes the player of a family.

The module imports JAX only for play.
"""

import dataclasses
import functools
from typing import Any, ClassVar

from assistax_envs.persons.rows import PROGRAM_VERSION
from population.networks.seat import Player, SeatSpec
from population.networks.spec import Role


@dataclasses.dataclass(frozen=True)
class PersonSpec(SeatSpec):
    """Persons of a task and a family: one program, whose parameters are "row", [30] each."""

    own_preferences: ClassVar[bool] = True
    episodes: ClassVar[int | None] = 4  # a person has one preference, and there are many persons

    task: str
    family: str
    role: Role = "human"

    @property
    def observation_size(self) -> int:
        """Width of the human's observation in the task."""
        from assistax_envs.persons.senses import SEAT_SIZES

        return SEAT_SIZES[self.task][0]

    @property
    def action_size(self) -> int:
        """Number of torques."""
        from assistax_envs.persons.senses import SEAT_SIZES

        return SEAT_SIZES[self.task][1]

    def to_json(self) -> dict[str, Any]:
        """Return the fields for a card."""
        return {"program": PROGRAM_VERSION, "family": self.family, "role": self.role}

    @property
    def digest(self) -> str:
        """Name of the spec, which differs from those of networks."""
        return f"persons-{self.family}"

    def player(self) -> Player:
        """Return the player of the family; imports JAX."""
        return _player(self.task, self.family)

    def humans(self, params: Any, settings: Any, preferences: Any) -> Any:
        """Return the bodies and preferences [P] of stacked rows."""
        from assistax_envs.persons.player import person_params

        return person_params(self.task, params["row"])

    def numbers(self, params: Any) -> Any:
        """Return the rows [P, 30]."""
        return params["row"]


@functools.cache
def _player(task: str, family: str) -> Player:
    from assistax_envs.persons.player import PersonPlayer

    return PersonPlayer(task, family)
