"""A person whose teeth are brushed: judges the brush, turns its head and opens its mouth.

Shapes: N simulations.
"""

import jax.numpy as jnp
from jax import Array

from assistax_envs.models.care_scenes import SEAT
from assistax_envs.models.teeth import INNER, PLACES, SHOWN_BY
from assistax_envs.tasks.gentle_base import STEP
from assistax_envs.tasks.mouth import OPENED, TURNED, Comfort, Perceived

YAW, JAW = SEAT.index("neck_yaw"), SEAT.index("jaw")


def feel(now: Perceived) -> Comfort:
    """Judge a brush by how hard it presses and how fast it rubs."""
    force = now.numbers["liked_press"]
    one, speed = jnp.ones_like(now.force), now.moving / now.numbers["liked_speed"]
    return Comfort(
        unit=force,
        preferred=force,
        speed=speed,
        near=one,
        way=jnp.where(jnp.asarray(INNER)[jnp.minimum(now.place, PLACES - 1)], -1.0, 1.0),
    )


def intend(now: Perceived) -> tuple[Array, Array]:
    """Return the seconds [N] for which it has been willing, and the wanted posture [N, 5], rad."""
    willing = jnp.where(now.place == now.before, now.willing + STEP * now.eager, 0.0)
    known = jnp.minimum(now.place, PLACES - 1)
    turn = TURNED * jnp.asarray(SHOWN_BY, jnp.float32)[known]
    jaw = jnp.where(jnp.asarray(INNER)[known], OPENED, 0.0)
    shown = jnp.zeros_like(now.aim).at[:, YAW].set(turn).at[:, JAW].set(jaw)
    ready = willing > now.numbers["slow_start"]
    return willing, jnp.where(ready[:, None], shown, now.aim)
