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
    if spec.latent:
        raise ValueError("a policy with a latent is unrolled with its actions: `unroll_memory`")
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


def unroll_memory(
    policy: Policy,
    params: Params,
    carry: Carry,
    obs: Float[Array, " T *batch O"],
    first: Bool[Array, " T *batch"],
    action: Float[Array, " T *batch A"],
) -> tuple[Float[Array, " T *batch H"], Float[Array, " T *batch Z"]]:
    """Return the memory's states and its latents, for each of T steps, of a policy that has one.

    `action` are the actions that followed the observations, as they were drawn.
    """
    if policy.spec.normalise:
        obs = normalise(params["normaliser"], obs)
    width = policy.spec.hidden[-1]
    before = jnp.concatenate([carry[None, ..., width:], action[:-1]])
    before = jnp.where(first[..., None], 0.0, before)
    seen, memory = jnp.concatenate([obs, before], axis=-1), params["memory"]
    states = _recur(memory["GRUCell_0"], carry[..., :width], seen, first)
    return states, _linear(memory["Dense_0"], states)


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
    states = _recur(params["GRUCell_0"], carry, features, first)
    return states[-1], states


def _recur(cell: Params, hidden: jax.Array, inputs: jax.Array, first: jax.Array) -> jax.Array:
    """Return the states of a `nn.GRUCell` after each of T steps [T, ..., H]."""
    products = jnp.concatenate([_linear(cell[f"i{gate}"], inputs) for gate in gru.GATES], axis=-1)
    kernel = jnp.concatenate([cell[f"h{gate}"]["kernel"] for gate in gru.GATES], axis=-1)
    return gru.remember(kernel, cell["hn"]["bias"], hidden, products, first)


def _linear(layer: Params, inputs: jax.Array) -> jax.Array:
    """Return what a dense layer makes of inputs [..., O]."""
    product = inputs @ layer["kernel"]
    return product + jnp.broadcast_to(layer["bias"], product.shape)
