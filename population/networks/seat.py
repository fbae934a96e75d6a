"""Protocols of a seat's spec and of the player that a spec makes.

Imports no JAX: the registry reads specs too.
"""

import dataclasses
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from jaxtyping import Array, Bool, Float

    from population.networks.spec import Role

Params = dict[str, Any]  # nested dicts of arrays
Carry = Any  # () for a feed-forward network, [..., H] for a recurrent one


class Player(Protocol):
    """Player that acts for policies of one spec, whose parameters are arguments.

    A player with `act_stack` acts for stacked policies at once, [G, R, O]; others are mapped over.
    """

    def initial_carry(self, batch_shape: tuple[int, ...]) -> Any:
        """Return the memory before the first observation, leaves [*batch, ...]."""
        ...

    def act(
        self,
        params: Any,
        carry: Any,
        obs: "Float[Array, '*batch O']",
        first: "Bool[Array, '*batch']",
    ) -> "tuple[Any, Float[Array, '*batch A']]":
        """Return the next memory and the actions; `first` is true if an episode begins."""
        ...


class Seat(Protocol):
    """Spec of policies that can be stacked and mapped over; hashable.

    A spec of humans may have `humans(params)`, which returns the `EnvParams` of stacked parameters;
    without it the disability setting and the preference give them.
    """

    @property
    def role(self) -> "Role":
        """The seat that the policies act in."""
        ...

    @property
    def observation_size(self) -> int:
        """Width of the policies' observation."""
        ...

    @property
    def action_size(self) -> int:
        """Width of the policies' action."""
        ...

    def __hash__(self) -> int:
        """Hash of the spec, since compiled programs are cached by spec."""
        ...

    def player(self) -> Player:
        """Return the player of these policies; imports JAX."""
        ...


@dataclasses.dataclass(frozen=True)
class SeatSizes:
    """Base of specs that are not our networks (scripts, ONNX, persons); subclasses add `player`."""

    role: "Role"
    observation_size: int
    action_size: int
