"""A person that eats: judges how a spoon waits and comes in, and opens and closes its mouth.

Shapes: N simulations.
"""

import jax.numpy as jnp
from jax import Array

from assistax_envs.models.care_scenes import SEAT
from assistax_envs.tasks.gentle_base import LIGHT, STEP
from assistax_envs.tasks.mouth import (
    BESIDE,
    FARTHEST,
    LEAVING,
    SLOWLY,
    TAKING,
    UNIT,
    WAITING,
    Comfort,
    Perceived,
)

JAW = SEAT.index("jaw")
WIDE, NARROW = 0.42, 0.05  # rad of the jaw: for a spoon, and on it
RIPE = 0.2  # of the logarithm of a spoon's distance, within which it waits as preferred
SOON = 0.25  # s that a spoon has to wait at the preferred place, beside the slow start
DEEP = 1.6  # times the preferred depth, from where on a bowl is too deep


def feel(now: Perceived) -> Comfort:
    """Judge a spoon that waits too near or too far, or goes too deep."""
    one, numbers = jnp.ones_like(now.force), now.numbers
    out = now.tool[:, 0]
    early = (now.place == WAITING) & (now.willing < SOON + numbers["slow_start"])
    # Squared: a spoon that waits 1.4 times as near or as far as preferred shows that.
    waits = (jnp.maximum(out, 1e-3) / numbers["liked_wait"]) ** 2
    waits = jnp.where(early, waits, one)
    deep = jnp.maximum(-out, 1e-4) / numbers["liked_depth"]
    near = jnp.where(out < 0.0, jnp.minimum(one, LIGHT * DEEP / deep), waits)
    near = jnp.where(now.place >= LEAVING, one, near)
    return Comfort(
        unit=UNIT * one,
        preferred=0.0 * one,
        speed=one,
        near=near,
        way=one,
    )


def intend(now: Perceived) -> tuple[Array, Array]:
    """Return the seconds [N] for which it has been willing, and the wanted posture [N, 5], rad."""
    numbers = now.numbers
    out, waits = now.tool[:, 0], _waits(now)
    off = jnp.log(jnp.maximum(out, 1e-3) / numbers["liked_wait"])
    ripens = waits * jnp.exp(-0.5 * (off / RIPE) ** 2) * now.eager
    waiting = now.place == WAITING
    # It closes between two bites, and has to want the next one anew.
    willing = jnp.where(waiting & (now.flag > 0.5), now.willing + STEP * ripens, 0.0)
    willing = jnp.where(waiting, willing, now.willing)
    ripe = willing > SOON + numbers["slow_start"]
    shut = (waiting & ~ripe) | (now.place == TAKING)
    jaw = jnp.where(shut, NARROW, WIDE)
    return willing, jnp.zeros_like(now.aim).at[:, JAW].set(jaw)


def _waits(now: Perceived) -> Array:
    """Return whether the spoon waits before the mouth [N]."""
    out, aside = now.tool[:, 0], jnp.linalg.norm(now.tool[:, 1:], axis=-1)
    return (out > 0.0) & (out < FARTHEST) & (aside < BESIDE) & (now.moving < SLOWLY)
