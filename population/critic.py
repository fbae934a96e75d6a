"""Critics: networks from normalised observations to state values."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
from flax import linen as nn

from population import networks
from population.networks import Carry, Params


@dataclasses.dataclass(frozen=True)
class CriticSpec:
    """Shape of a critic network."""

    observation_size: int  # width of its input
    torso: str = "mlp"  # "mlp" or "gru"
    hidden: tuple[int, ...] = (128, 128)  # widths of the hidden layers
    activation: str = "tanh"  # after each dense hidden layer


class Critic:
    """The network of a `CriticSpec`; its input is normalised by the caller."""

    def __init__(self, spec: CriticSpec) -> None:
        self.spec = spec
        self._module = _Value(spec)

    def init(self, key: jax.Array) -> Params:
        """Return fresh parameters."""
        obs = jnp.zeros(self.spec.observation_size)
        return self._module.init(key, self.initial_carry(()), obs, jnp.zeros((), bool))["params"]

    def initial_carry(self, batch_shape: tuple[int, ...]) -> Carry:
        """Return the recurrent state before the first observation."""
        return networks.initial_carry(self.spec, batch_shape)

    def step(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, jax.Array]:
        """Return the new carry and the values [...] of obs [..., O]."""
        output: Any = self._module.apply({"params": params}, carry, obs, first)
        return output

    def unroll(
        self, params: Params, carry: Carry, obs: jax.Array, first: jax.Array
    ) -> tuple[Carry, jax.Array]:
        """Apply `step` along the leading time axis of obs [T, ..., O] and first [T, ...]."""
        return networks.unroll(self.spec, self.step, params, carry, obs, first)


class _Value(nn.Module):
    spec: CriticSpec

    @nn.compact
    def __call__(self, carry: Carry, obs: jax.Array, first: jax.Array) -> tuple[Carry, jax.Array]:
        carry, features = networks.torso(self.spec, carry, obs, first)
        return carry, networks.dense(1, 1.0)(features)[..., 0]
