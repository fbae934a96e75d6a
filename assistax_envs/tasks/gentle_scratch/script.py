"""Script of gentle scratch, and its numbers."""

import jax
import jax.numpy as jnp

from assistax_envs.tasks.chain import Chain, Numbers, Script, capped
from assistax_envs.tasks.skin_script import (
    SKIN_RANGES,
    above_point,
    drive_on_skin,
    rub_as_liked,
    rubbing,
)

NUMBERS: dict[str, float] = {
    "approach": 2.03,
    "fast": 0.19,
    "hover": 0.0226,
    "yield": -0.00685,
    "force": 5.53,
    "soften": 0.00669,
    "press": 0.0338,
    "lift": 0.0506,
    "stop": 57.5,
    "touch": 0.411,
    "lean": 1.36,
    "turn": 0.0329,
    "facing": -0.952,
    "damping": 0.00186,
    "over": 0.0201,
    "descend": 0.0453,
    "rub": 10.3,
    "slide": 0.0799,
    "ahead": 0.0,
    "drag": 0.0,
}
# Of the script that is told the wishes, in place of those above.
CAREFUL: dict[str, float] = {
    "heed": 0.775,
    "pace": 1.91,
    "ahead": 0.835,
    "drag": 0.63,
    "soften": 0.00591,
    "press": 0.113,
    "lift": 0.0521,
    "lean": 1.35,
    "turn": 0.0604,
    "damping": 0.00257,
    "approach": 2.0,
    "fast": 0.155,
    "hover": 0.0227,
    "yield": -0.00815,
    "touch": 0.584,
    "over": 0.0292,
    "descend": 0.0448,
    "rub": 22.7,
}
# Lengths in m, speeds in m/s, forces in N.
RANGES: dict[str, tuple[float, float]] = SKIN_RANGES | {
    "over": (0.01, 0.06),  # aside of the itch, up to which the tool goes down
    "descend": (0.02, 0.1),
    "rub": (4.0, 30.0),  # 1/s, towards the itch's end
    "slide": (0.02, 0.1),
}


def stroke(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Go above the end of the itch, down to a light force, then from end to end."""
    towards, normal, force = obs[:, 30:33], obs[:, 37:40], 10.0 * obs[:, 43:44]
    aside, off, above = above_point(n, obs, towards, normal)
    descend = 2.0 * aside - n["descend"] * normal
    rub = rubbing(chain, n, obs, normal, force, capped(n["rub"] * aside, n["slide"]))
    on = (off < n["over"]) & (normal[:, 2:] > n["facing"])
    velocity = jnp.where(on, jnp.where(force > n["touch"], rub, descend), above)
    return drive_on_skin(chain, n, obs, normal, force, velocity)


SCRIPT = Script(stroke, NUMBERS, RANGES, told=rub_as_liked, careful=CAREFUL)
