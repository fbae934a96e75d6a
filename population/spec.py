"""What a policy network looks like, as data. Imports no JAX: the registry reads it too."""

import dataclasses
import hashlib
import json
from typing import Literal

Role = Literal["robot", "human"]
ROLES: tuple[Role, ...] = ("robot", "human")


@dataclasses.dataclass(frozen=True)
class PolicySpec:
    """Shape of a policy network; policies of one spec can be stacked and mapped over."""

    role: Role  # the seat this policy acts in
    observation_size: int  # width of the observation it reads
    action_size: int  # width of the action it returns
    torso: Literal["mlp", "gru"] = "mlp"  # "gru" embeds, then recurs
    hidden: tuple[int, ...] = (128, 128)  # widths of the hidden layers; (embedding, GRU) for "gru"
    activation: Literal["tanh", "relu"] = "tanh"  # after each dense hidden layer
    squash: Literal["clip", "tanh"] = "clip"  # how a Gaussian sample is brought into [-1, 1]
    std: Literal["parameter", "state"] = (
        "parameter"  # log standard deviation: one vector, or a head on the torso
    )
    normalise: bool = True  # whether parameters hold the mean and std of observations

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise ValueError(f"role is {self.role!r}; allowed are {', '.join(ROLES)}")
        for name in ("observation_size", "action_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least 1")
        for name, allowed in (
            ("torso", ("mlp", "gru")),
            ("activation", ("tanh", "relu")),
            ("squash", ("clip", "tanh")),
            ("std", ("parameter", "state")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"{name} is {getattr(self, name)!r}; allowed are {', '.join(allowed)}"
                )
        object.__setattr__(self, "hidden", tuple(self.hidden))
        if not self.hidden or min(self.hidden) < 1:
            raise ValueError(f"hidden is {self.hidden}; give at least one width, each 1 or more")

    def to_json(self) -> dict:
        """Return the spec as JSON-ready values; `PolicySpec(**spec.to_json())` gives it back."""
        return {**dataclasses.asdict(self), "hidden": list(self.hidden)}

    @property
    def digest(self) -> str:
        """First eight hex digits of the spec's sha256: names the shard of its policies."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()[:8]
