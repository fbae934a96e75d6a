"""What policies and critics share.

The torso, unrolling over time, and the normalisation of observations.
"""

import math
from collections.abc import Callable
from typing import Any, Protocol

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Float

Params = dict[str, Any]  # nested dicts of arrays
Carry = Any  # () for a feed-forward network, [..., H] for a recurrent one

NORMALISED_LIMIT = 10.0  # normalised observations are clipped to this many standard deviations
HIDDEN_SCALE = math.sqrt(2.0)  # orthogonal gain of hidden layers


class TorsoSpec(Protocol):
    """The fields of a spec that describe a torso."""

    @property
    def torso(self) -> str: ...
    @property
    def hidden(self) -> tuple[int, ...]: ...
    @property
    def activation(self) -> str: ...


def dense(width: int, scale: float) -> nn.Dense:
    """Return a dense layer with orthogonal weights of the given gain and zero bias."""
    return nn.Dense(width, kernel_init=nn.initializers.orthogonal(scale))


def torso(
    spec: TorsoSpec, carry: Carry, obs: jax.Array, first: jax.Array
) -> tuple[Carry, jax.Array]:
    """Apply the hidden layers.

    To be called inside a compact module, which then owns the layers by flat names.
    """
    activation = {"tanh": nn.tanh, "relu": nn.relu}[spec.activation]
    embedding = spec.hidden[:-1] if spec.torso == "gru" else spec.hidden
    features = obs
    for width in embedding:
        features = activation(dense(width, HIDDEN_SCALE)(features))
    if spec.torso == "gru":
        carry = jnp.where(first[..., None], 0.0, carry)
        carry, features = nn.GRUCell(spec.hidden[-1])(carry, features)
    return carry, features


def initial_carry(spec: TorsoSpec, batch_shape: tuple[int, ...]) -> Carry:
    """Return the recurrent state before the first observation.

    () for a feed-forward torso, else [*batch_shape, H].
    """
    return jnp.zeros((*batch_shape, spec.hidden[-1])) if spec.torso == "gru" else ()


def unroll(
    spec: TorsoSpec,
    step: Callable[..., tuple[Carry, Any]],
    params: Params,
    carry: Carry,
    obs: jax.Array,
    first: jax.Array,
) -> tuple[Carry, Any]:
    """Apply `step` along the leading time axis of obs [T, ..., O] and first [T, ...]."""
    if spec.torso == "mlp":
        return step(params, carry, obs, first)
    return jax.lax.scan(lambda carry, x: step(params, carry, *x), carry, (obs, first))


def normalise(normaliser: Params, obs: Float[Array, "*batch O"]) -> Float[Array, "*batch O"]:
    """Return obs [..., O] centred and scaled by mean [O] and std [O], clipped to a fixed limit."""
    mean, std = (jnp.broadcast_to(normaliser[name], obs.shape) for name in ("mean", "std"))
    return jnp.clip((obs - mean) / std, -NORMALISED_LIMIT, NORMALISED_LIMIT)
