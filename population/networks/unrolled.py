"""Networks over a chunk of T steps, as learning reads it; acting is `step` of the network.

What does not wait for the step before is done for all steps at once, and only the recurrent
products stay in a scan. Sums are therefore rounded in another order than in `step`.
"""

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Bool, Float

from population.networks import gru
from population.networks.policy import (
    INITIAL_LOG_STD,
    LOG_STD_RANGE,
    Critic,
    CriticSpec,
    Gaussian,
    Policy,
    normalise,
)
from population.networks.seat import Carry, Params
from population.networks.spec import PolicySpec


def unroll_policy(
    policy: Policy,
    params: Params,
    carry: Carry,
    obs: Float[Array, " T *batch O"],
    first: Bool[Array, " T *batch"],
) -> tuple[Carry, Gaussian]:
    """Return the carry after a chunk, and the distributions over actions [T, ..., A]."""
    spec = policy.spec
    if spec.torso == "mlp":
        return policy.step(params, carry, obs, first)
    if spec.normalise:
        obs = normalise(params["normaliser"], obs)
    carry, features = _remember(spec, params, carry, obs, first)
    place = len(spec.hidden) - 1
    mean = _linear(params[f"Dense_{place}"], features)
    if spec.std == "state":
        log_std = INITIAL_LOG_STD + _linear(params[f"Dense_{place + 1}"], features)
    else:
        log_std = params["log_std"]
    log_std = jnp.broadcast_to(jnp.clip(log_std, *LOG_STD_RANGE), mean.shape)
    return carry, Gaussian(mean, log_std, spec.squash)


def unroll_critic(
    critic: Critic,
    params: Params,
    carry: Carry,
    obs: Float[Array, " T *batch O"],
    first: Bool[Array, " T *batch"],
) -> tuple[Carry, Float[Array, " T *batch"]]:
    """Return the carry after a chunk, and the values [T, ...]."""
    if critic.spec.torso == "mlp":
        return critic.step(params, carry, obs, first)
    obs = critic.inputs(params, obs)
    carry, features = _remember(critic.spec, params, carry, obs, first)
    return carry, _linear(params[f"Dense_{len(critic.spec.hidden) - 1}"], features)[..., 0]


def _remember(
    spec: PolicySpec | CriticSpec,
    params: Params,
    carry: Carry,
    obs: Float[Array, " T *batch O"],
    first: Bool[Array, " T *batch"],
) -> tuple[Carry, Float[Array, " T *batch H"]]:
    """Apply the hidden layers of a recurrent torso to a chunk of T steps; see `nn.GRUCell`."""
    activation = {"tanh": nn.tanh, "relu": nn.relu}[spec.activation]
    features = obs
    for layer in range(len(spec.hidden) - 1):
        features = activation(_linear(params[f"Dense_{layer}"], features))
    cell = params["GRUCell_0"]
    inputs = jnp.concatenate([_linear(cell[f"i{gate}"], features) for gate in gru.GATES], axis=-1)
    kernel = jnp.concatenate([cell[f"h{gate}"]["kernel"] for gate in gru.GATES], axis=-1)
    states = gru.remember(kernel, cell["hn"]["bias"], carry, inputs, first)
    return states[-1], states


def _linear(layer: Params, inputs: jax.Array) -> jax.Array:
    """Return what a dense layer makes of inputs [..., O]."""
    product = inputs @ layer["kernel"]
    return product + jnp.broadcast_to(layer["bias"], product.shape)
