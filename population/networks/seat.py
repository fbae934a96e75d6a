"""What a seat of the environment asks of who sits there: a spec, which makes its player.

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
    """Acts for policies of one spec, whose parameters it is given.

    One that has `act_stack` acts for stacked policies at once, [G, R, O]; others are mapped over.
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
        """Return the next memory and the actions; `first` where an episode begins."""
        ...


class Seat(Protocol):
    """Describes policies that can be stacked and mapped over; hashable.

    One of humans that has `humans(params)` says who they are, the `EnvParams` of stacked
    parameters; of others their disability setting and preference say it.
    """

    @property
    def role(self) -> "Role":
        """The seat that they act in."""
        ...

    @property
    def observation_size(self) -> int:
        """Width of the observation that they read."""
        ...

    @property
    def action_size(self) -> int:
        """Width of the action that they return."""
        ...

    def __hash__(self) -> int:
        """Make it a key: what is compiled is kept by spec."""
        ...

    def player(self) -> Player:
        """Return what plays them; imports JAX."""
        ...


@dataclasses.dataclass(frozen=True)
class SeatSizes:
    """What a spec that is no network of ours has of a seat; it adds its `player`."""

    role: "Role"
    observation_size: int
    action_size: int
