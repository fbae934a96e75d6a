"""Shape of a policy network, as data. Imports no JAX: the registry reads it too."""

import dataclasses
from typing import Literal

from pydantic import NonNegativeInt, PositiveInt

from assistax_base.digest import json_sha256
from assistax_base.validated import Widths, validated
from population.networks.seat import Player, SeatSpec

Role = Literal["robot", "human"]
ROLES: tuple[Role, ...] = ("robot", "human")


@validated
class PolicySpec(SeatSpec):
    """Shape of a policy network; policies of one spec can be stacked and mapped over."""

    role: Role  # the seat this policy acts in
    observation_size: PositiveInt  # width of the observation it reads
    action_size: PositiveInt  # width of the action it returns
    torso: Literal["mlp", "gru"] = "mlp"  # "gru" embeds, then recurs
    hidden: Widths = (128, 128)  # widths of the hidden layers; (embedding, GRU) for "gru"
    activation: Literal["tanh", "relu"] = "tanh"  # after each dense hidden layer
    squash: Literal["clip", "tanh"] = "clip"  # how a Gaussian sample is brought into [-1, 1]
    # Log standard deviation: one vector, or a head on the torso.
    std: Literal["parameter", "state"] = "parameter"
    normalise: bool = True  # whether parameters hold the mean and std of observations
    # Width of the latent that a memory infers from observations and own actions, an input of the
    # "mlp". The memory is a GRU as wide as the last hidden layer. 0 turns it off.
    latent: NonNegativeInt = 0

    def __post_init__(self) -> None:
        if self.latent and self.torso == "gru":
            raise ValueError(
                f"latent is {self.latent} and torso 'gru'; a policy has one memory: choose mlp"
            )

    def to_json(self) -> dict:
        """Return the spec as JSON-ready values; `PolicySpec(**spec.to_json())` gives it back."""
        content = {**dataclasses.asdict(self), "hidden": list(self.hidden)}
        if not self.latent:  # left out, so that specs without it keep their digest
            del content["latent"]
        return content

    def player(self) -> Player:
        """Return the network that plays policies of this spec; imports JAX."""
        from population.networks.policy import Policy

        return Policy(self)

    @property
    def digest(self) -> str:
        """First eight hex digits of the spec's sha256; they name the shard of its policies."""
        return json_sha256(self.to_json(), spaced=True)[:8]


def spec_from_json(value: object) -> PolicySpec:
    """Return the spec of a value that `PolicySpec.to_json` returned.

    Raises:
        ValueError: A field is missing, unknown, or of another type.
    """
    if isinstance(value, PolicySpec):
        return value
    if not isinstance(value, dict):
        raise ValueError(f"a policy spec is an object, not {type(value).__name__}")
    try:
        return PolicySpec(**value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"policy spec: {error}") from None
