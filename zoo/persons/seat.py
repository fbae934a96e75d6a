"""What persons ask of the human's seat: a spec, which makes the player of all of a family.

Imports no JAX until somebody plays.
"""

import dataclasses
import functools
from typing import Any

from assistax_envs.persons.rows import PROGRAM_VERSION
from population.networks.seat import Params, Player
from population.networks.spec import Role


@dataclasses.dataclass(frozen=True)
class PersonSpec:
    """Persons of a task and a family: one program, whose parameters are "row", [25] each."""

    task: str
    family: str
    role: Role = "human"

    @property
    def observation_size(self) -> int:
        """Width of what the human of the task observes."""
        from assistax_envs.persons.senses import SEAT_SIZES

        return SEAT_SIZES[self.task][0]

    @property
    def action_size(self) -> int:
        """Number of torques."""
        from assistax_envs.persons.senses import SEAT_SIZES

        return SEAT_SIZES[self.task][1]

    def to_json(self) -> dict[str, Any]:
        """Return what a card says of it."""
        return {"program": PROGRAM_VERSION, "family": self.family, "role": self.role}

    @property
    def digest(self) -> str:
        """A name beside those of networks."""
        return f"persons-{self.family}"

    def player(self) -> Player:
        """Return what acts for them; imports JAX."""
        return _player(self.task, self.family)

    def humans(self, params: Params) -> Any:
        """Return the `EnvParams` [P] of stacked parameters: their own bodies and wishes."""
        from assistax_envs.persons.player import person_params

        return person_params(self.task, params["row"])


@functools.cache
def _player(task: str, family: str) -> Player:
    from assistax_envs.persons.player import PersonPlayer

    return PersonPlayer(task, family)
