"""Words of the human as the robot hears them: one-hot numbers at the end of what it observes."""

from typing import Any

import jax
import jax.numpy as jnp

from assistax_envs.preferences import HEARD, WORDS


def heard(state: Any, word: jax.Array | None) -> tuple[jax.Array | None, jax.Array | None]:
    """Return the word that the robot hears after a step, and for how long it still does."""
    if state.word is None or state.heard is None:
        return None, None
    left = jnp.maximum(state.heard - 1, 0)
    if word is None:
        return state.word, left
    word = jnp.clip(jnp.asarray(word, jnp.int32), 0, len(WORDS))
    return jnp.where(word > 0, word, state.word), jnp.where(word > 0, HEARD, left)


def with_word(
    obs: dict[str, jax.Array], word: jax.Array | None, heard: jax.Array | None
) -> dict[str, jax.Array]:
    """Return observations in which robot and central critics hear the word, as one-hot numbers."""
    if word is None or heard is None:
        return obs
    said = jax.nn.one_hot(jnp.where(heard > 0, word, 0) - 1, len(WORDS), dtype=jnp.float32)
    heard_by = {name: jnp.concatenate([obs[name], said], axis=-1) for name in ("robot", "global")}
    return obs | heard_by


def told(obs: dict[str, jax.Array], added: int) -> jax.Array:
    """Return the observation [N, O] of a robot that is told the wishes, from all observations.

    Central critics observe the same `added` numbers, before the words.
    """
    own, words = jnp.split(obs["robot"], (obs["robot"].shape[-1] - len(WORDS),), axis=-1)
    return jnp.concatenate([own, before_words(obs["global"], added), words], axis=-1)


def before_words(obs: jax.Array, count: int) -> jax.Array:
    """Return the last numbers [..., count] of observations [..., O] before the words."""
    last = obs.shape[-1] - len(WORDS)
    return obs[..., last - count : last]
