"""Tremor of the human's arm: zero-mean torque in the 4 to 12 Hz band of human tremor."""

import math

import jax
import jax.numpy as jnp
import numpy as np

BAND = (4.0, 12.0)  # Hz


class TremorFilter:
    """White noise through a second-order Butterworth band-pass, scaled to unit variance."""

    def __init__(self, rate: float) -> None:
        """Design the filter for `rate` samples a second, Hz, by the bilinear transform."""
        low, high = (math.tan(math.pi * edge / rate) for edge in BAND)
        width, centre = high - low, low * high
        total = 1.0 + width + centre
        gain = width / total  # and the variance that white noise of variance 1 leaves with
        self._b = (math.sqrt(gain) * np.array([1.0, 0.0, -1.0])).astype(np.float32)
        self._a = np.array([total, 2.0 * (centre - 1.0), 1.0 - width + centre], float) / total
        self._a = self._a.astype(np.float32)

    def initial(self, size: int, joints: int) -> jax.Array:
        """Return the state [N, joints, 2] of a filter at rest."""
        return jnp.zeros((size, joints, 2), jnp.float32)

    def step(self, state: jax.Array, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the next state, and the output [N, joints] for `noise` [N, joints].

        Transposed direct form II.
        """
        output = self._b[0] * noise + state[..., 0]
        first = self._b[1] * noise - self._a[1] * output + state[..., 1]
        second = self._b[2] * noise - self._a[2] * output
        return jnp.stack([first, second], axis=-1), output
