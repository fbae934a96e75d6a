"""Protocols of a seat's spec and of the player that a spec makes.

Imports no JAX: the registry reads specs too.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Array, Bool, Float

    from assistax_envs.disability import Disability
    from assistax_envs.humans import EnvParams
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
    """Spec of policies that can be stacked and mapped over; hashable."""

    own_preferences: ClassVar[bool]
    episodes: ClassVar[int | None]

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

    def humans(
        self,
        params: Mapping[str, Any],
        settings: "Sequence[str | Disability]",
        preferences: "Sequence[str] | np.ndarray | None",
    ) -> "EnvParams":
        """Return the bodies and preferences of humans; see `SeatSpec.humans`."""
        ...

    def numbers(self, params: Mapping[str, Any]) -> "np.ndarray | None":
        """Return the numbers that describe the policies; see `SeatSpec.numbers`."""
        ...


class SeatSpec:
    """Base of the specs of a seat; a subclass adds role, sizes and `player`.

    Attributes:
        own_preferences: Whether humans bring preferences of their own, so that `humans` reads
            their parameters alone.
        episodes: How many episodes a pair plays if no number is asked for; None for the task's.
    """

    own_preferences: ClassVar[bool] = False
    episodes: ClassVar[int | None] = None

    def humans(
        self,
        params: Mapping[str, Any],
        settings: "Sequence[str | Disability]",
        preferences: "Sequence[str] | np.ndarray | None",
    ) -> "EnvParams":
        """Return the bodies and preferences of P humans.

        Args:
            params: Their stacked parameters, leaves [P, ...].
            settings: Their disability settings [P].
            preferences: Names of their preferences, [P] or [P, K]; None to draw them.
        """
        from assistax_envs.humans import disability_params

        return disability_params(settings, preferences)

    def numbers(self, params: Mapping[str, Any]) -> "np.ndarray | None":
        """Return the numbers [P, W] that describe the policies; None if nothing does."""
        return None

    def to_json(self) -> dict[str, Any]:
        """Return what a card says of the spec, JSON-ready."""
        return {"kind": type(self).__name__}

    @property
    def digest(self) -> str:
        """Short name of the spec."""
        return type(self).__name__


@dataclasses.dataclass(frozen=True)
class SeatSizes(SeatSpec):
    """Base of specs that are not our networks (scripts, ONNX, persons); subclasses add `player`."""

    role: "Role"
    observation_size: int
    action_size: int
