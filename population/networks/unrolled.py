"""Networks over a chunk of T steps, for learning; acting uses the network's `step`.

Computation that does not depend on the step before is done for all steps at once, and only the
recurrent products stay in a scan. Sums are therefore rounded in another order than in `step`.
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
    if policy.spec.latent:
        raise ValueError("a policy with a latent is unrolled with its actions: `unroll_memory`")
    if policy.spec.torso == "mlp":
        return policy.step(params, carry, obs, first)
    states, gaussian = unroll_states(policy, params, carry, obs, first)
    return states[-1], gaussian


def unroll_states(
    policy: Policy,
    params: Params,
    carry: Carry,
    obs: Float[Array, " T *batch O"],
    first: Bool[Array, " T *batch"],
) -> tuple[Float[Array, " T *batch H"], Gaussian]:
    """Return a gru's states in a chunk, and the distributions over actions [T, ..., A]."""
    products = _products_of_policy(policy, params, obs)
    states = gru.remember(*_recurrent(params["GRUCell_0"]), carry, products, first)
    return states, _gaussian(policy.spec, params, states)


def unroll_both(
    policy: Policy,
    critic: Critic,
    params: tuple[Params, Params],
    carries: tuple[Carry, Carry],
    obs: tuple[Float[Array, " T N O"], Float[Array, " T N C"]],
    first: Bool[Array, " T N"],
) -> tuple[Gaussian, Float[Array, " T N"]]:
    """Return the policy's distributions and the critic's values of a chunk.

    If both are recurrent and equally wide, their recurrences are one scan: on a GPU the steps of a
    scan cost the same for two small networks as for one.
    """
    actor, valuer = policy.spec, critic.spec
    if not actor.torso == valuer.torso == "gru" or actor.hidden[-1] != valuer.hidden[-1]:
        _, gaussian = unroll_policy(policy, params[0], carries[0], obs[0], first)
        return gaussian, unroll_critic(critic, params[1], carries[1], obs[1], first)[1]
    seen = critic.inputs(params[1], obs[1])
    products = [
        _products_of_policy(policy, params[0], obs[0]),
        _products(valuer, params[1], seen),
    ]
    weights = [_recurrent(network["GRUCell_0"]) for network in params]
    kernel, bias = (jnp.stack(leaves) for leaves in zip(*weights, strict=True))
    both = jax.vmap(gru.remember, in_axes=(0, 0, 0, 0, None))
    states = both(kernel, bias, jnp.stack(carries), jnp.stack(products), first)
    return _gaussian(actor, params[0], states[0]), _value(valuer, params[1], states[1])


def _products_of_policy(policy: Policy, params: Params, obs: jax.Array) -> jax.Array:
    """Return the cell's input products [T, ..., 3 H] for a recurrent policy's raw observations."""
    if policy.spec.normalise:
        obs = normalise(params["normaliser"], obs)
    return _products(policy.spec, params, obs)


def _gaussian(spec: PolicySpec, params: Params, features: jax.Array) -> Gaussian:
    """Return the distribution that a policy's heads give for its last features."""
    place = len(spec.hidden) - 1
    mean = _linear(params[f"Dense_{place}"], features)
    if spec.std == "state":
        log_std = INITIAL_LOG_STD + _linear(params[f"Dense_{place + 1}"], features)
    else:
        log_std = params["log_std"]
    log_std = jnp.broadcast_to(jnp.clip(log_std, *LOG_STD_RANGE), mean.shape)
    return Gaussian(mean, log_std, spec.squash)


def _value(spec: CriticSpec, params: Params, features: jax.Array) -> jax.Array:
    """Return the values of a critic's last features."""
    return _linear(params[f"Dense_{len(spec.hidden) - 1}"], features)[..., 0]


def unroll_memory(
    policy: Policy,
    params: Params,
    carry: Carry,
    obs: Float[Array, " T *batch O"],
    first: Bool[Array, " T *batch"],
    action: Float[Array, " T *batch A"],
) -> tuple[Float[Array, " T *batch H"], Float[Array, " T *batch Z"]]:
    """Return the memory's states and its latents at each of T steps.

    `action` are the actions that followed the observations, as they were drawn.
    """
    if policy.spec.normalise:
        obs = normalise(params["normaliser"], obs)
    width = policy.spec.hidden[-1]
    before = jnp.concatenate([carry[None, ..., width:], action[:-1]])
    before = jnp.where(first[..., None], 0.0, before)
    seen, memory = jnp.concatenate([obs, before], axis=-1), params["memory"]
    products = _cell_products(memory["GRUCell_0"], seen)
    states = gru.remember(*_recurrent(memory["GRUCell_0"]), carry[..., :width], products, first)
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
    products = _products(critic.spec, params, critic.inputs(params, obs))
    states = gru.remember(*_recurrent(params["GRUCell_0"]), carry, products, first)
    return states[-1], _value(critic.spec, params, states)


def _products(spec: PolicySpec | CriticSpec, params: Params, obs: jax.Array) -> jax.Array:
    """Return the input products [T, ..., 3 H] of a recurrent torso's cell over a chunk.

    See `nn.GRUCell`.
    """
    activation = {"tanh": nn.tanh, "relu": nn.relu}[spec.activation]
    features = obs
    for layer in range(len(spec.hidden) - 1):
        features = activation(_linear(params[f"Dense_{layer}"], features))
    return _cell_products(params["GRUCell_0"], features)


def _cell_products(cell: Params, inputs: jax.Array) -> jax.Array:
    """Return the products of inputs with a cell's input weights, gates side by side [..., 3 H]."""
    return jnp.concatenate([_linear(cell[f"i{gate}"], inputs) for gate in gru.GATES], axis=-1)


def _recurrent(cell: Params) -> tuple[jax.Array, jax.Array]:
    """Return the recurrent kernel and bias of a cell."""
    kernel = jnp.concatenate([cell[f"h{gate}"]["kernel"] for gate in gru.GATES], axis=-1)
    return kernel, cell["hn"]["bias"]


def _linear(layer: Params, inputs: jax.Array) -> jax.Array:
    """Return the output of a dense layer for inputs [..., O]."""
    product = inputs @ layer["kernel"]
    return product + jnp.broadcast_to(layer["bias"], product.shape)
