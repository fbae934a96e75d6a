"""Parts of the scripts that keep a tool on the skin at a force.

In the code h is the height of a point over the tool along the skin's normal, negative while the
tool is above the skin. Shapes: N simulations.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from assistax_envs.tasks.base import unit
from assistax_envs.tasks.chain import DOWN, Chain, Numbers, capped

# Least and largest value that a search tries of each number. Lengths in m, speeds in m/s, forces
# in N; "yield" is m/s for each N of the force that the tool feels, along it.
SKIN_RANGES = {
    "approach": (1.0, 6.0),  # 1/s, of the way above the skin
    "fast": (0.1, 0.4),
    "hover": (0.02, 0.1),
    "yield": (-0.01, 0.01),
    "force": (1.5, 8.0),  # that the touch is kept at
    "soften": (0.001, 0.02),  # m/s for each N beside it
    "press": (0.01, 0.06),
    "lift": (0.01, 0.2),
    "stop": (8.0, 60.0),  # above it the tool only lifts
    "touch": (0.1, 1.0),  # above it the tool is on the skin
    "lean": (0.0, 2.0),  # weight of the skin's normal in where the shaft points
    "turn": (0.0, 0.2),
    "facing": (-1.0, 0.5),  # least cosine between the skin's normal and up
    "damping": (2e-4, 5e-3),
    "ahead": (0.0, 1.2),  # share of the force that is kept, which the motors press with anyway
    "drag": (0.0, 1.5),  # friction that is made up for, as a share of the force
}


def rub_as_liked(n: Numbers, wishes: Mapping[str, jax.Array]) -> Numbers:
    """Return the numbers of a script that keeps to the liked force and speed."""
    return {"force": n["heed"] * wishes["force"], "slide": n["pace"] * wishes["speed"]}


def above_point(
    n: Numbers, obs: jax.Array, towards: jax.Array, normal: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return the way aside to a point, its length, and the velocity that leads above it."""
    h = (towards * normal).sum(-1, keepdims=True)
    aside = towards - h * normal
    above = capped(n["approach"] * (aside + (n["hover"] + h) * normal), n["fast"])
    off = jnp.linalg.norm(aside, axis=-1, keepdims=True)
    return aside, off, above + capped(n["yield"] * obs[:, 21:24], n["fast"])


def pressing(
    chain: Chain, n: Numbers, obs: jax.Array, normal: jax.Array, force: jax.Array
) -> jax.Array:
    """Return the speed outward [N, 1] that brings the force to the one that is kept.

    A share "ahead" of that force comes from the motors as they are, without waiting for a touch.
    """
    speed = n["soften"] * (force - n["force"])
    speed = speed - n["ahead"] * n["force"] * chain.yields(obs, normal)
    return jnp.clip(speed, -n["press"], n["lift"])


def rubbing(
    chain: Chain,
    n: Numbers,
    obs: jax.Array,
    normal: jax.Array,
    force: jax.Array,
    velocity: jax.Array,
) -> jax.Array:
    """Return the velocity [N, 3] of a tool that rubs by `velocity` at the force that is kept.

    "drag" times the friction is made up for.
    """
    way = unit(velocity)
    rub = velocity + n["drag"] * force * chain.yields(obs, way) * way
    return rub + pressing(chain, n, obs, normal, force) * normal


def drive_on_skin(
    chain: Chain, n: Numbers, obs: jax.Array, normal: jax.Array, force: jax.Array, velocity: Any
) -> jax.Array:
    """Return actions [N, 7] that move the tool, or lift it if it presses too hard.

    The shaft leans into the skin.
    """
    velocity = jnp.where(force > n["stop"], n["lift"] * normal, velocity)
    shaft = capped(jnp.asarray(DOWN) - n["lean"] * normal, 1.0)
    return chain.drive(obs, velocity, shaft, turn=n["turn"], damping=n["damping"])
