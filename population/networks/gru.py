"""Gated recurrent unit over many steps, with a custom gradient (Cho et al., 2014).

JAX's derivative of a scan adds to the gradient of its weights at every step, by one small product
each. Here the backward scan carries the hidden state's gradient alone, and one product over all
steps and simulations gives the gradient of the weights.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

GATES = "rzn"  # reset, update, new: the order of the products [..., 3 H]

Steps = Float[Array, " T *batch G"]


@jax.custom_vjp
def remember(
    kernel: Float[Array, "H G"],
    bias: Float[Array, " H"],
    hidden: Float[Array, "*batch H"],
    inputs: Steps,
    first: Bool[Array, " T *batch"],
) -> Float[Array, " T *batch H"]:
    """Return the hidden states after each of T steps.

    r = s(x_r + W_r h), z = s(x_z + W_z h), n = tanh(x_n + r (W_n h + b)), h' = (1 - z) n + z h,
    with the logistic function s.

    Args:
        kernel: W_r, W_z and W_n side by side, G = 3 H.
        bias: b.
        hidden: h before the first step.
        inputs: x_r, x_z and x_n side by side [T, ..., 3 H].
        first: Whether a step starts an episode, before which h is forgotten [T, ...].
    """
    return _forward(kernel, bias, hidden, inputs, first)[0]


def _forward(
    kernel: jax.Array, bias: jax.Array, hidden: jax.Array, inputs: jax.Array, first: jax.Array
) -> tuple[jax.Array, tuple[Any, ...]]:
    """Return the hidden states [T, ..., H], and the residuals for `_backward`."""

    def step(hidden: jax.Array, now: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, Any]:
        products, starts = now
        hidden = jnp.where(starts[..., None], 0.0, hidden)
        x_r, x_z, x_n = jnp.split(products, 3, axis=-1)
        h_r, h_z, h_n = jnp.split(hidden @ kernel, 3, axis=-1)
        r, z = jax.nn.sigmoid(x_r + h_r), jax.nn.sigmoid(x_z + h_z)
        h_n = h_n + jnp.broadcast_to(bias, h_n.shape)
        n = jnp.tanh(x_n + r * h_n)
        after = (1.0 - z) * n + z * hidden
        return after, (after, (hidden, r, z, n, h_n))

    states, saved = jax.lax.scan(step, hidden, (inputs, first))[1]
    return states, (kernel, first, saved)


def _backward(residuals: tuple[Any, ...], gradient: jax.Array) -> tuple[jax.Array | None, ...]:
    """Return the gradients of kernel, bias, initial hidden state and inputs; None for `first`."""
    kernel, first, saved = residuals

    def step(later: jax.Array, now: Any) -> tuple[jax.Array, Any]:
        grad, starts, (hidden, r, z, n, h_n) = now
        grad = grad + later
        x_n = grad * (1.0 - z) * (1.0 - jnp.square(n))  # gradient before the tanh
        x_z = grad * (hidden - n) * z * (1.0 - z)
        x_r = x_n * h_n * r * (1.0 - r)
        products = jnp.concatenate([x_r, x_z, x_n * r], axis=-1)
        earlier = jnp.where(starts[..., None], 0.0, grad * z + products @ kernel.T)
        return earlier, (products, x_n)

    start = jnp.zeros_like(gradient[0])
    hidden_grad, (products, x_n) = jax.lax.scan(step, start, (gradient, first, saved), reverse=True)
    size = x_n.shape[-1]
    flat = products.reshape(-1, 3 * size)
    kernel_grad = saved[0].reshape(-1, size).T @ flat
    inputs_grad = jnp.concatenate([products[..., : 2 * size], x_n], axis=-1)
    bias_grad = flat[:, 2 * size :].sum(0)
    return kernel_grad, bias_grad, hidden_grad, inputs_grad, None


remember.defvjp(_forward, _backward)
