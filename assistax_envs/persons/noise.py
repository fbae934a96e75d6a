"""Chance that a person brings along: a hash of its episode's seed and the step, exact integers.

The same seed and step give the same numbers on every machine, whatever else is in the batch.
"""

import jax
import jax.numpy as jnp
import numpy as np

_ODD = np.uint32(0x9E3779B9)  # the golden ratio's bits
_FIRST, _SECOND = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)  # of MurmurHash3's finaliser


def seed_of(words: jax.Array) -> jax.Array:
    """Return a seed [N] uint32 from any bits [N, W] uint32."""
    places = jnp.arange(1, words.shape[1] + 1, dtype=jnp.uint32)[None] * _ODD
    return _mixed(_mixed(words ^ places).sum(axis=1, dtype=jnp.uint32))


def uniform(seed: jax.Array, age: jax.Array, count: int) -> jax.Array:
    """Return numbers [N, count] in (0, 1) for seeds [N] at their ages [N], in steps."""
    places = jnp.arange(1, count + 1, dtype=jnp.uint32)[None] * _ODD
    steps = _mixed(seed + age.astype(jnp.uint32) * _SECOND)
    bits = _mixed(steps[:, None] ^ places) >> 8
    return (bits.astype(jnp.float32) + 0.5) * np.float32(2.0**-24)


def normal(share: jax.Array) -> jax.Array:
    """Return the quantiles of a standard normal distribution at shares in (0, 1)."""
    return jax.scipy.special.ndtri(share)


def _mixed(words: jax.Array) -> jax.Array:
    words = (words ^ (words >> 16)) * _FIRST
    words = (words ^ (words >> 13)) * _SECOND
    return words ^ (words >> 16)
