"""Script of gentle wave, and its numbers."""

import jax
import jax.numpy as jnp

from assistax_envs.tasks.chain import Chain, Numbers, Script, capped
from assistax_envs.tasks.skin_script import SKIN_RANGES, above_point, drive_on_skin, pressing

NUMBERS = {
    "approach": 2.0,
    "fast": 0.2,
    "hover": 0.025,
    "yield": -0.005,
    "force": 4.0,
    "soften": 0.007,
    "press": 0.03,
    "lift": 0.05,
    "stop": 50.0,
    "touch": 0.4,
    "lean": 1.4,
    "turn": 0.03,
    "ahead": 0.0,
    "damping": 0.002,
    "over": 0.02,
    "descend": 0.04,
    "slide": 0.05,
}
RANGES = {name: SKIN_RANGES[name] for name in NUMBERS if name in SKIN_RANGES} | {
    "over": (0.01, 0.06),  # m aside of an end, up to which the tool goes down
    "descend": (0.02, 0.1),  # m/s
    "slide": (0.02, 0.1),  # m/s along the forearm
}


def wave(chain: Chain, n: Numbers, obs: jax.Array) -> jax.Array:
    """Go above an end of the forearm, down to a light force, then along the skin."""
    towards, normal, force = obs[:, 30:33], obs[:, 34:37], 10.0 * obs[:, 37:38]
    aside, off, above = above_point(n, obs, towards, normal)
    descend = 2.0 * aside - n["descend"] * normal
    rub = capped(10.0 * aside, n["slide"]) + pressing(chain, n, obs, normal, force) * normal
    off_skin = jnp.where(off < n["over"], descend, above)
    velocity = jnp.where(force > n["touch"], rub, off_skin)
    return drive_on_skin(chain, n, obs, normal, force, velocity)


SCRIPT = Script(wave, NUMBERS, RANGES)
