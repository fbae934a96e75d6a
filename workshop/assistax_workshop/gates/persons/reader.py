"""Readers of wishes: networks with a memory that learn from the robot's observations of persons.

A reader sees a few seconds and says in which third of all persons each wish lies. It learns with
some persons and is tested with others. Shapes: P persons, T moments, F features, W wishes.
"""

import dataclasses
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

from assistax_envs.own_settings import key_of, own_settings
from assistax_envs.preferences import WORDS

POOLED = 20  # steps of a moment: 0.4 s, for which a word is heard
UPDATES, BATCH = 2_000, 64
RATE, DECAY, NOISE = 3e-3, 1e-2, 0.2  # of AdamW, and of the features in training
SEEN = ("both", "body", "words", "shuffled")  # by readers; the last learns labels of other persons


@dataclasses.dataclass(frozen=True)
class Windows:
    """What a robot observed of persons, in as many steps of each."""

    features: np.ndarray  # [P, T, F] float32; the last are of words
    thirds: np.ndarray  # [P, W] int: 0, 1 or 2


def moments(obs: np.ndarray) -> np.ndarray:
    """Return features [P, T, F] of observations [S, P, O]: means of moments, changes, words."""
    steps = len(obs) - len(obs) % POOLED
    change = np.abs(np.diff(obs, axis=0, prepend=obs[:1]))
    body = -len(WORDS)
    parts = (obs[..., :body], change[..., :body], obs[..., body:])
    pooled = np.concatenate(parts, axis=-1)[:steps].astype(np.float32)
    pooled = pooled.reshape(steps // POOLED, POOLED, *pooled.shape[1:]).mean(axis=1)
    return np.moveaxis(pooled, 1, 0)


@own_settings()
def read_thirds(learn: Windows, test: Windows, updates: int = UPDATES) -> dict[str, np.ndarray]:
    """Return the thirds [P, W] that readers find in the windows `test`, by what they see.

    Readers are those of `SEEN`. "shuffled" sees all, but learned with labels of other persons.
    """
    mean = learn.features.mean(axis=(0, 1))
    spread = learn.features.std(axis=(0, 1)) + 1e-6
    x, seen = (
        jnp.asarray(np.clip((part.features - mean) / spread, -5.0, 5.0)) for part in (learn, test)
    )
    mixed = np.random.default_rng(0).permutation(learn.thirds)
    labels = jnp.asarray(np.stack([learn.thirds] * 3 + [mixed]))
    network = _Reader(wishes=learn.thirds.shape[1])
    masks = jnp.asarray(_masks(x.shape[-1]))
    params = _learned(network, x, labels, masks, updates)

    @jax.jit
    def guess(params: dict, mask: jax.Array) -> jax.Array:
        logits: Any = network.apply(params, seen * mask)
        return logits.argmax(axis=-1)

    found = [guess(jax.tree.map(lambda leaf, i=i: leaf[i], params), masks[i]) for i in range(4)]
    return dict(zip(SEEN, map(np.asarray, found), strict=True))


def share_found(found: np.ndarray, thirds: np.ndarray) -> float:
    """Return the share [P] of thirds that are found, as the mean over thirds.

    A reader that always says the same has a third, however persons are distributed.
    """
    hits = [float((found[thirds == third] == third).mean()) for third in np.unique(thirds)]
    return float(np.mean(hits)) if hits else 0.0


class _Reader(nn.Module):
    """Gated recurrent unit over moments, whose last state says the third of each wish."""

    wishes: int
    width: int = 32

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        """Return the logits [P, W, 3] for features [P, T, F]."""
        x = nn.relu(nn.Dense(self.width)(x))
        states: Any = nn.RNN(nn.GRUCell(self.width))(x)
        last = jnp.concatenate([states[:, -1], states.mean(axis=1)], axis=-1)
        return nn.Dense(3 * self.wishes)(last).reshape(-1, self.wishes, 3)


def _masks(width: int) -> np.ndarray:
    """Return the features [4, 1, 1, F] that the readers of `SEEN` see, as 0 and 1."""
    words = (np.arange(width) >= width - len(WORDS)).astype(np.float32)
    masks = np.stack([np.ones_like(words), 1.0 - words, words, np.ones_like(words)])
    return masks[:, None, None]


def _learned(
    network: _Reader, x: jax.Array, labels: jax.Array, masks: jax.Array, updates: int
) -> dict:
    """Return the parameters of all readers, leaves [4, ...]."""
    optimiser = optax.adamw(optax.cosine_decay_schedule(RATE, updates), weight_decay=DECAY)

    def loss(params: dict, mask: jax.Array, labels: jax.Array, key: jax.Array) -> jax.Array:
        draw, shake = jax.random.split(key)
        who = jax.random.randint(draw, (BATCH,), 0, len(x))
        some = x[who] + NOISE * jax.random.normal(shake, (BATCH, *x.shape[1:]))
        logits: Any = network.apply(params, some * mask)
        return optax.softmax_cross_entropy_with_integer_labels(logits, labels[who]).mean()

    def update(now: tuple, key: jax.Array) -> tuple[tuple, None]:
        params, state = now
        gradient = jax.vmap(jax.grad(loss), (0, 0, 0, None))(params, masks, labels, key)
        changes, state = jax.vmap(optimiser.update)(gradient, state, params)
        return (optax.apply_updates(params, changes), state), None

    keys = jax.random.split(key_of(0), updates + 1)
    first = network.init(keys[0], x[:1])
    params = jax.tree.map(lambda leaf: jnp.stack([leaf] * len(masks)), first)
    state = jax.vmap(optimiser.init)(params)
    return jax.jit(lambda now, keys: jax.lax.scan(update, now, keys))((params, state), keys[1:])[0][
        0
    ]
