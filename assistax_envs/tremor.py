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

    def shake(
        self, state: jax.Array, keys: jax.Array, time: jax.Array, share: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Return the next state, and the torque [N, joints]; without tremor no noise is drawn.

        Args:
            state: [N, joints, 2] of the filter.
            keys: [N] of the episodes' noise.
            time: [N] int32, steps since reset.
            share: [N] of the torque that the tremor has.
        """

        def noise() -> tuple[jax.Array, jax.Array]:
            drawn = jax.vmap(jax.random.fold_in)(keys, time)
            white = jax.vmap(lambda key: jax.random.normal(key, state.shape[1:2]))(drawn)
            tremor, output = self.step(state, white)
            return tremor, share[:, None] * output

        def calm() -> tuple[jax.Array, jax.Array]:
            return state, jnp.zeros(state.shape[:2], jnp.float32)

        return jax.lax.cond(jnp.any(share > 0.0), noise, calm)

    def step(self, state: jax.Array, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the next state, and the output [N, joints] for `noise` [N, joints].

        Transposed direct form II.
        """
        output = self._b[0] * noise + state[..., 0]
        first = self._b[1] * noise - self._a[1] * output + state[..., 1]
        second = self._b[2] * noise - self._a[2] * output
        return jnp.stack([first, second], axis=-1), output
