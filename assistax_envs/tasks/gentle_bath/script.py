"""Script of gentle bath, and its numbers."""

import jax
import jax.numpy as jnp

from assistax_envs.tasks.base import unit
from assistax_envs.tasks.chain import Chain, Numbers, Script
from assistax_envs.tasks.skin_script import (
    SKIN_RANGES,
    above_point,
    drive_on_skin,
    rub_as_liked,
    rubbing,
)

NUMBERS: dict[str, float] = {
    "approach": 2.83,
    "fast": 0.332,
    "hover": 0.0492,
    "yield": 0.00147,
    "force": 3.98,
    "soften": 0.0159,
    "press": 0.0423,
    "lift": 0.0435,
    "stop": 41.3,
    "touch": 0.773,
    "lean": 1.12,
    "turn": 0.228,
    "facing": -1.0,
    "damping": 0.00392,
    "over": 0.055,
    "keep": 0.142,
    "back": 0.0154,
    "slide": 0.0634,
    "ahead": 0.0,
    "drag": 0.0,
}
# Of the script that is told the wishes, in place of those above.
CAREFUL: dict[str, float] = {
    "heed": 0.768,
    "pace": 0.797,
    "ahead": 0.368,
    "drag": 0.445,
    "soften": 0.00979,
    "press": 0.0825,
    "lift": 0.134,
    "lean": 1.28,
    "turn": 0.153,
    "damping": 0.00408,
    "approach": 2.29,
    "fast": 0.35,
    "hover": 0.0458,
    "yield": 0.00295,
    "touch": 0.496,
    "over": 0.0533,
    "keep": 0.132,
    "back": 0.0228,
}
# Lengths in m, speeds in m/s, forces in N.
RANGES: dict[str, tuple[float, float]] = SKIN_RANGES | {
    "over": (0.01, 0.1),
    "keep": (0.02, 0.3),  # the same, of a tool that is on the skin
    "back": (0.005, 0.05),  # beyond a point, where the tool turns back
    "slide": (0.03, 0.12),
    "turn": (0.0, 0.3),
    "damping": (5e-5, 5e-3),
}


def wipe(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Go to the nearest point that faces the pad, then along the skin to the next."""
    towards, normal, force = obs[:, 30:33], obs[:, 33:36], 10.0 * obs[:, 37:38]
    aside, off, above = above_point(n, obs, towards, normal)
    # Over the point and beyond it, to and fro along the arm: on until past it, then back.
    along = unit(obs[:, 24:27] - obs[:, 27:30])
    onward = jnp.sign((chain.velocity(obs) * along).sum(-1, keepdims=True)) * along
    way = jnp.where(off < n["back"], onward, aside / jnp.maximum(off, 1e-3))
    rub = rubbing(chain, n, obs, normal, force, n["slide"] * way)
    on = (off < n["over"]) | ((off < n["keep"]) & (force > n["touch"]))
    velocity = jnp.where(on & (normal[:, 2:] > n["facing"]), rub, above)
    return drive_on_skin(chain, n, obs, normal, force, velocity)


SCRIPT = Script(wipe, NUMBERS, RANGES, told=rub_as_liked, careful=CAREFUL)
