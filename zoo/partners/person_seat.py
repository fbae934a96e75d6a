"""Spec of persons in the human's seat, which makes their player.

The module imports JAX only for play.
"""

import dataclasses
import functools
from typing import Any, ClassVar

from assistax_envs.persons.rows import PROGRAM_VERSION, WIDTH
from population.networks.seat import Player, SeatSpec
from population.networks.spec import Role


@dataclasses.dataclass(frozen=True)
class PersonSpec(SeatSpec):
    """Persons of a task: one program, whose parameters are "row", see `rows.marked`."""

    own_preferences: ClassVar[bool] = True
    episodes: ClassVar[int | None] = 4  # a person has one preference, and there are many persons

    task: str
    role: Role = "human"
    own: str = ""  # name of the installed package's family that plays, if one does
    files: str = ""  # sha256 of that package's files

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
        own = {"own": self.own, "files": self.files} if self.own else {}
        return {"program": PROGRAM_VERSION, "role": self.role} | own

    @property
    def digest(self) -> str:
        """Name of the spec, which differs from those of networks."""
        return "-".join(filter(None, ("persons", self.own, self.files[:16])))

    def player(self) -> Player:
        """Return the player of all persons; imports JAX."""
        return _player(self.task, self.own, self.files)

    def humans(self, params: Any, settings: Any, preferences: Any) -> Any:
        """Return the bodies and preferences [P] of stacked rows."""
        from assistax_envs.persons.player import person_params

        return person_params(self.task, params["row"])

    def numbers(self, params: Any) -> Any:
        """Return the rows [P, 30]."""
        return params["row"][:, :WIDTH]


@functools.cache
def _player(task: str, own: str, files: str) -> Player:
    from assistax_envs.persons.player import PersonPlayer

    return PersonPlayer(task, own, files)
